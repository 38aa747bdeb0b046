"""The photograph and the cloud of a frame in the browser, with clicks and fitted poses drawn over them.

The scene's frame is the camera's. The photograph stands at depth 1, where the ray through a pixel meets it at that
pixel from wherever the browser looks.
"""

from __future__ import annotations

import contextlib
import io
import secrets
from collections.abc import Callable, Iterator
from dataclasses import replace
from http import HTTPStatus
from typing import Any, Literal

import numpy as np

from toolee_robot.frames import Array, transform_points
from toolee_robot.perception.offline.annotation.clicks import Click, Role
from toolee_robot.perception.offline.annotation.frame_set import AnnotatedFrame
from toolee_robot.perception.offline.annotation.poses import AnnotatedEnd
from toolee_robot.types import CameraIntrinsics

View = Literal["photograph", "cloud"]
COLORS: dict[Role, tuple[int, int, int]] = {
    Role.RIM: (255, 170, 0),
    Role.SURFACE: (0, 150, 255),
    Role.THROAT: (255, 90, 90),
    Role.END_A: (255, 130, 220),
    Role.END_B: (190, 120, 255),
    Role.TIP: (255, 90, 90),
    Role.SHAFT: (0, 150, 255),
    Role.HANDLE: (120, 230, 120),
    Role.BOX: (235, 235, 235),
}
"""Colours of the clicks by role."""
AXES = 0.03
"""Length of a drawn pose's axes [m]."""
RED_GREEN_BLUE = ((255, 0, 0), (0, 200, 0), (0, 60, 255))
MARGIN = 1.04
"""Height or width of the browser's picture over that of the whole photograph."""
_MARK = 4.0
"""Half of a click's cross [px] at whole size."""
_WITHIN = 0.02
"""How near a ray must pass to a point of the cloud [rad]."""
LARGEST_MESSAGE = 2**16
"""Of a browser [B]; it sends clicks, choices and its camera's pose, of some hundred bytes each."""


@contextlib.contextmanager
def _guarded(token: str) -> Iterator[None]:
    """Let a server that begins meanwhile answer only this computer's pages that know the token, the path's first part.

    viser looks at neither Host nor Origin, has no token, and takes messages of 50 MB.
    """
    from websockets.asyncio import server

    serve = server.serve

    def guarded(*args: Any, process_request: Callable[[Any, Any], Any], **options: Any) -> Any:
        def checked(connection: Any, request: Any) -> Any:
            host, origin = request.headers.get("Host", ""), request.headers.get("Origin")
            given, _, rest = request.path.removeprefix("/").partition("/")
            ours = host.rpartition(":")[0] in ("127.0.0.1", "localhost") and origin in (None, f"http://{host}")
            if not ours or not secrets.compare_digest(given.encode(errors="replace"), token.encode()):
                return connection.respond(HTTPStatus.FORBIDDEN, "open the whole address that the command printed\n")
            return process_request(connection, replace(request, path=f"/{rest}"))

        return serve(*args, process_request=checked, **options | {"max_size": LARGEST_MESSAGE})

    server.serve = guarded  # type: ignore[assignment,misc]
    try:
        yield
    finally:
        server.serve = serve  # type: ignore[misc]


class AnnotationScene:
    """The page's picture, until it is closed.

    Args:
        port: Port of the page; the next free one is taken where it is in use.
        clicked: Called with the pixel of each click on the picture.

    Attributes:
        server: The `viser.ViserServer`.
        view: What is shown.

    Raises:
        ModuleNotFoundError: viser is not installed.
    """

    def __init__(self, port: int, clicked: Callable[[float, float], None]) -> None:
        import viser

        self._token = secrets.token_urlsafe(16)
        with contextlib.redirect_stdout(io.StringIO()), _guarded(self._token):  # it prints a banner
            self.server = viser.ViserServer(host="127.0.0.1", port=port, verbose=False)
        self.view: View = "photograph"
        self._clicked = clicked
        self._camera: CameraIntrinsics | None = None
        self._points, self._pixels = np.empty((0, 3)), np.empty((0, 2))
        self._drawn: list[Any] = []
        self._zoom, self._middle = 1.0, np.zeros(2)
        self.server.scene.set_up_direction("-y")
        self.server.scene.on_click()(self._on_click)
        self.server.on_client_connect(self._connect)

    @property
    def address(self) -> str:
        """Address of the page, with its token."""
        return f"http://127.0.0.1:{self.server.get_port()}/{self._token}/"

    def close(self) -> None:
        """Stop serving."""
        self.server.stop()

    def show_frame(self, annotated: AnnotatedFrame) -> None:
        """Show a frame's photograph and cloud, without clicks."""
        frame, k = annotated.frame, annotated.frame.intrinsics
        self._camera = k
        corner = self._on_photograph(np.array([[-0.5, -0.5], [k.width - 0.5, k.height - 0.5]]))
        size, centre = corner[1] - corner[0], corner.mean(0)
        scene = self.server.scene
        self._photograph = scene.add_image(
            "/photograph", frame.rgb, float(size[0]), float(size[1]), format="png", position=tuple(centre)
        )
        v, u = np.nonzero(np.isfinite(frame.depth) & (frame.depth > 0))
        z = frame.depth[v, u].astype(np.float64)
        self._pixels = np.stack([u, v], 1).astype(np.float64)
        self._points = self._on_photograph(self._pixels) * z[:, None]
        self._cloud = scene.add_point_cloud(
            "/cloud", self._points, frame.rgb[v, u], point_size=0.0009, precision="float32", point_shape="circle"
        )
        self.look(self.view)

    def look(self, view: View, zoom: float = 1.0, about: Array | None = None) -> None:
        """Choose between photograph and cloud, and aim the browser's camera.

        Args:
            view: What is shown.
            zoom: How many times larger than the whole picture.
            about: Pixel in the middle, (2,); None: the picture's.
        """
        assert self._camera is not None
        self.view, self._zoom = view, zoom
        whole = np.array([self._camera.width - 1, self._camera.height - 1]) / 2
        self._middle = whole if about is None else np.asarray(about)
        self._photograph.visible, self._cloud.visible = view == "photograph", view == "cloud"
        self._aim(list(self.server.get_clients().values()))

    def draw(self, clicks: list[tuple[Click, bool]], annotated: AnnotatedFrame) -> None:
        """Draw clicks and fitted poses.

        Args:
            clicks: The clicks, and which of them were left out as wrong.
            annotated: The frame with its fits.
        """
        for handle in self._drawn:
            handle.remove()
        self._drawn = []
        size = _MARK / self._zoom**0.5
        for n, (click, wrong) in enumerate(clicks):
            arms = np.array([[-1, 0], [1, 0], [0, -1], [0, 1]] if not wrong else [[-1, -1], [1, 1], [-1, 1], [1, -1]])
            pixels = np.array([click.u, click.v]) + size * arms
            color = (255, 0, 0) if wrong else COLORS[click.role]
            self._lines(f"/drawn/click{n}", self._placed(pixels, click), [color] * 2, 2.5)
        for n, end in enumerate(annotated.annotated):
            self._draw_end(f"/drawn/end{n}", end)

    def _draw_end(self, name: str, end: AnnotatedEnd) -> None:
        X = end.fit.X_camera_ee
        tips = transform_points(X, AXES * np.eye(3))
        for k in range(3):
            self._lines(f"{name}/axis{k}", self._flat(np.stack([X[:3, 3], tips[k]])), [RED_GREEN_BLUE[k]], 4.0)
        if end.circle is not None:
            loop = np.stack([end.circle, np.roll(end.circle, -1, axis=0)], 1).reshape(-1, 3)
            self._lines(f"{name}/rim", self._flat(loop), [(255, 255, 255)] * len(end.circle), 2.0)
        x0, y0, x1, y1 = end.box
        corners = np.array([[x0, y0], [x1, y0], [x1, y0], [x1, y1], [x1, y1], [x0, y1], [x0, y1], [x0, y0]]) - 0.5
        if self.view == "photograph":
            self._lines(f"{name}/box", self._on_photograph(corners) * 0.999, [(200, 200, 200)] * 4, 1.5)

    def _lines(self, name: str, points: Array, colors: list[tuple[int, int, int]], thickness: float) -> None:
        """Line segments between every two points (2 N, 3)."""
        shades = np.repeat(np.array(colors, np.uint8)[:, None], 2, axis=1)
        handle = self.server.scene.add_line_segments(
            name, points.reshape(-1, 2, 3), shades, thickness=thickness, thickness_units="screen"
        )
        self._drawn.append(handle)

    def _placed(self, pixels: Array, click: Click) -> Array:
        """Where the marks of a click are drawn: on the photograph, or at the cloud's point nearest to its ray."""
        rays = self._on_photograph(pixels)
        if self.view == "photograph":
            return rays * 0.998
        nearest = np.argmin(((self._pixels - [click.u, click.v]) ** 2).sum(1))
        return rays * (self._points[nearest, 2] - 0.002)

    def _flat(self, points: Array) -> Array:
        """Points (N, 3) [m] as they are in the cloud, or as they appear on the photograph."""
        return points if self.view == "cloud" else points / points[:, 2:] * 0.997

    def _on_photograph(self, pixels: Array) -> Array:
        assert self._camera is not None
        return self._camera.rays(pixels)

    def _connect(self, client: Any) -> None:
        shape = [0.0]

        def aim(_camera: Any) -> None:
            """Aim again when the picture's shape has changed: the panel is docked, the window resized."""
            if abs(client.camera.aspect - shape[0]) > 0.01:
                shape[0] = client.camera.aspect
                self._aim([client])

        client.camera.on_update(aim)
        aim(client.camera)

    def _aim(self, clients: list[Any]) -> None:
        if self._camera is None:
            return
        middle = self._on_photograph(self._middle[None])[0]
        half = 0.5 * self._camera.height / self._camera.fy
        if self.view == "cloud":
            near = np.argmin(((self._pixels - self._middle) ** 2).sum(1))
            middle = self._points[near]
        for client in clients:
            with client.atomic():
                client.camera.fov = float(2 * np.arctan(MARGIN * half))
                narrow = max(1.0, self._camera.width / self._camera.height / max(client.camera.aspect, 0.1))
                back = middle[2] * narrow / self._zoom
                client.camera.up_direction = (0.0, -1.0, 0.0)
                client.camera.position = (middle[0], middle[1], middle[2] - back)
                client.camera.look_at = tuple(middle)

    def _on_click(self, event: Any) -> None:
        pixel = self.pixel_of(np.array(event.ray_origin), np.array(event.ray_direction))
        if pixel is not None:
            self._clicked(*pixel)

    def pixel_of(self, origin: Array, direction: Array) -> tuple[float, float] | None:
        """The pixel that a ray of the browser's camera means.

        Args:
            origin: Where it starts, (3,).
            direction: Where it goes, (3,).

        Returns:
            u and v [px]; None where it meets neither photograph nor cloud.
        """
        k = self._camera
        if k is None:
            return None
        if self.view == "photograph":
            if abs(direction[2]) < 1e-9 or (1 - origin[2]) / direction[2] <= 0:
                return None
            x, y, _ = origin + direction * (1 - origin[2]) / direction[2]
            u, v = k.fx * x + k.cx, k.fy * y + k.cy
            return (float(u), float(v)) if -0.5 <= u < k.width - 0.5 and -0.5 <= v < k.height - 0.5 else None
        if not len(self._points):
            return None
        away = self._points - origin
        along = away @ direction / np.linalg.norm(direction)
        aside = np.sqrt(np.maximum((away**2).sum(1) - along**2, 0.0)) / np.maximum(along, 1e-6)
        aside[along <= 0] = np.inf
        best = float(aside.min())
        if best > _WITHIN:
            return None
        # Of the points that the ray passes about as near to, the one in front.
        candidates = np.flatnonzero(aside < best + 0.002)
        u, v = self._pixels[candidates[np.argmin(along[candidates])]]
        return float(u), float(v)
