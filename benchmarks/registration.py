"""Registration and undistortion: times in one thread, and errors on synthetic scenes whose true depth is known.

python -m benchmarks.registration
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from toolee_robot.devices.cameras.lens import DepthRegistration, Lens, LensModel
from toolee_robot.frames import Array, transform
from toolee_robot.types import CameraIntrinsics

DEPTH = Lens(
    CameraIntrinsics(365.5, 365.5, 254.9, 205.4, 512, 424),
    LensModel.BROWN_CONRADY,
    (0.09, -0.27, 0.0, 0.0, 0.09),
)
"""A depth camera like the Kinect v2's, whose distortion is of this size."""
COLORS = {
    "512x424": CameraIntrinsics(365.5, 365.5, 256.0, 212.0, 512, 424),
    "640x480": CameraIntrinsics(460.0, 460.0, 320.0, 240.0, 640, 480),
}
"""Colour cameras, by size."""
UNDISTORTED = Lens(CameraIntrinsics(910.0, 910.0, 640.0, 360.0, 1280, 720), LensModel.BROWN_CONRADY, (0.1, -0.2, 0, 0))
"""A colour camera whose images, with a depth of the same lens, are undistorted."""
OBLIQUE = 0.1
"""Slope of a surface above which its depth tells the error of a pixel's place; its depth changes by this share per unit
of direction."""


@dataclass(frozen=True)
class RegistrationFigures:
    """What the benchmark measured."""

    color: str
    """Size of the colour image."""
    milliseconds: float
    """Median time of a registration in one thread [ms]."""
    surface_rms: float
    """Root mean square of the error on oblique surfaces [px]."""
    surface_most: float
    """Largest of these errors but for one in a thousand [px]."""
    edge_rms: float
    """Root mean square of the error of the nearer surface's edges [px]."""
    edge_mean: float
    """Mean of these errors, positive outwards [px]."""
    holes: float
    """Share of the pixels that both cameras see and that got no depth."""


def undistortion_time(seed: int = 0, repeats: int = 30) -> float:
    """Measure the undistortion of a colour image and its depth."""
    rng, k = np.random.default_rng(seed), UNDISTORTED.intrinsics
    rgb = rng.integers(0, 255, (k.height, k.width, 3)).astype(np.uint8)
    depth = rng.random((k.height, k.width), np.float32)
    undistort, times = UNDISTORTED.undistortion(), []
    for _ in range(repeats + 1):
        begin = time.perf_counter()
        undistort.color(rgb)
        undistort.depth(depth)
        times.append(time.perf_counter() - begin)
    return 1e3 * float(np.median(times[1:]))


@dataclass(frozen=True)
class _Scene:
    """A rectangle in front of a plane, in the colour camera's frame: z = 1 / (a x + b y + c) along a direction."""

    back: Array
    """The plane's a, b, c."""
    front: Array
    """The rectangle's."""
    window: tuple[float, float, float, float]
    """The rectangle's limits x0, x1, y0, y1 at z = 1."""
    turn: float
    """Turn of the rectangle about the optical axis [rad]."""

    def inverse_depths(self, x: Array, y: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Inverse depths of both planes along directions in the colour camera, and where the rectangle is."""
        back = self.back[0] * x + self.back[1] * y + self.back[2]
        front = self.front[0] * x + self.front[1] * y + self.front[2]
        c, s = np.cos(self.turn), np.sin(self.turn)
        u, v = c * x + s * y, c * y - s * x
        x0, x1, y0, y1 = self.window
        return back, front, (x0 < u) & (u < x1) & (y0 < v) & (v < y1)


def measure_registration(color: str, seed: int = 0, scenes: int = 8, repeats: int = 30) -> RegistrationFigures:
    """Measure time and error of the registration."""
    rng = np.random.default_rng(seed)
    target = COLORS[color]
    surface: list[Array] = []
    edges: list[Array] = []
    holes: list[float] = []
    times: list[float] = []
    for _ in range(scenes):
        turn = rng.normal(0.0, 0.02, 3)
        R = np.array([[1, -turn[2], turn[1]], [turn[2], 1, -turn[0]], [-turn[1], turn[0], 1]])
        Q, _ = np.linalg.qr(R)
        Q *= np.sign(np.diag(Q))
        X_color_depth = transform(Q, [rng.uniform(-0.06, 0.06), rng.uniform(-0.01, 0.01), rng.uniform(-0.01, 0.01)])
        register = DepthRegistration(DEPTH, target, X_color_depth)
        scene = _Scene(
            back=np.array([*rng.uniform(-0.5, 0.5, 2), 1 / rng.uniform(0.9, 1.2)]),
            front=np.array([*rng.uniform(-0.5, 0.5, 2), 1 / rng.uniform(0.5, 0.65)]),
            window=(-rng.uniform(0.1, 0.2), rng.uniform(0.1, 0.2), -rng.uniform(0.1, 0.2), rng.uniform(0.1, 0.2)),
            turn=rng.uniform(0.1, 0.3),
        )
        depth = _render(scene, X_color_depth)
        register(depth)
        for _ in range(max(1, repeats // scenes)):
            begin = time.perf_counter()
            registered = register(depth)
            times.append(time.perf_counter() - begin)
        _judge(scene, target, registered, surface, edges, holes)
    on_surfaces, at_edges = np.concatenate(surface), np.concatenate(edges)
    return RegistrationFigures(
        color,
        1e3 * float(np.median(times)),
        float(np.sqrt(np.mean(on_surfaces**2))),
        float(np.quantile(on_surfaces, 0.999)),
        float(np.sqrt(np.mean(at_edges**2))),
        float(np.mean(at_edges)),
        float(np.mean(holes)),
    )


def _render(scene: _Scene, X_color_depth: Array) -> NDArray[np.float32]:
    """What the depth camera measures: the nearer surface along each pixel's ray, exactly."""
    x, y = DEPTH.rays().astype(np.float64)
    ray = np.einsum("ij,jhw->ihw", X_color_depth[:3, :3], np.stack([x, y, np.ones_like(x)]))
    p = X_color_depth[:3, 3]
    depths = []
    for plane in (scene.back, scene.front):
        # On the plane: 1 = a X + b Y + c Z with (X, Y, Z) = p + d ray.
        along = plane[0] * ray[0] + plane[1] * ray[1] + plane[2] * ray[2]
        depths.append((1 - plane @ p) / along)
    back, front = depths
    point = p[:, None, None] + front * ray
    _, _, inside = scene.inverse_depths(point[0] / point[2], point[1] / point[2])
    return np.where(inside & (front > 0), front, back).astype(np.float32)


def _judge(
    scene: _Scene,
    target: CameraIntrinsics,
    registered: NDArray[np.float32],
    surface: list[Array],
    edges: list[Array],
    holes: list[float],
) -> None:
    x, y = Lens(target).rays().astype(np.float64)
    back, front, inside = scene.inverse_depths(x, y)
    seen = np.zeros(inside.shape, bool)
    border = target.width // 6
    seen[border:-border, border:-border] = True
    known = registered > 0
    # A pixel's error on a surface: by how many pixels along the gradient its depth is off.
    pixel = 1 / target.fx
    for plane, inverse, where in ((scene.back, back, ~inside), (scene.front, front, inside)):
        slope = float(np.hypot(plane[0], plane[1]))
        with np.errstate(divide="ignore"):
            off = np.abs(1 / registered - inverse) / (slope * pixel)
        clear = where & known & seen & _away(inside, 6)
        if slope > OBLIQUE:
            surface.append(off[clear])
    # An edge's error, row by row: where the nearer surface begins and ends.
    nearer = known & (
        np.abs(1 / np.where(known, registered, 1.0) - front) < np.abs(1 / np.where(known, registered, 1.0) - back)
    )
    x0, x1, y0, y1 = scene.window
    c, s = np.cos(scene.turn), np.sin(scene.turn)
    corners = [(c * u - s * v, s * u + c * v) for u, v in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))]
    xs, ys = zip(*corners, strict=True)
    rows = np.arange(target.height)
    across = (rows - target.cy) / target.fy
    lowest, highest = sorted(ys)[1] + 6 * pixel, sorted(ys)[2] - 6 * pixel
    for row in rows[(across > lowest) & (across < highest)]:
        true = sorted(_crossings(xs, ys, across[row]))
        found = np.flatnonzero(nearer[row])
        if len(true) == 2 and len(found):
            left, right = (target.fx * value + target.cx for value in true)
            edges.append(np.array([left - (found[0] - 0.5), (found[-1] + 0.5) - right]))
    shadow = _away(inside, int(0.15 * target.fx))
    visible = seen & (inside | shadow)
    holes.append(float(np.mean(~known[visible])))


def _crossings(xs: tuple[float, ...], ys: tuple[float, ...], at: float) -> list[float]:
    found = []
    for i in range(4):
        j = (i + 1) % 4
        if (ys[i] - at) * (ys[j] - at) < 0:
            found.append(xs[i] + (at - ys[i]) / (ys[j] - ys[i]) * (xs[j] - xs[i]))
    return found


def _away(inside: NDArray[np.bool_], pixels: int) -> NDArray[np.bool_]:
    """Pixels that are farther from the rectangle's edges than this."""
    kernel = np.ones((2 * pixels + 1, 2 * pixels + 1), np.uint8)
    mask = inside.astype(np.uint8)
    near = cv2.dilate(mask, kernel) != cv2.erode(mask, kernel)
    return ~near


def main() -> None:
    """Measure and print."""
    cv2.setNumThreads(1)
    for color in COLORS:
        f = measure_registration(color)
        print(
            f"{f.color}: {f.milliseconds:.1f} ms; surfaces {f.surface_rms:.2f} px RMS, 99.9 % {f.surface_most:.2f} px"
        )
        print(f"  edges {f.edge_rms:.2f} px RMS, {f.edge_mean:+.2f} px outwards; holes {f.holes:.2%}")
    print(f"undistortion of 1280x720, colour and depth: {undistortion_time():.1f} ms")


if __name__ == "__main__":
    main()
