"""The emulated camera of a rehearsal: the simulated world, rendered and with the sensors' noise.

A RealSense's pictures go through its maker's SDK as a software device. The other makers' SDKs have none: there the
pictures come in at the place of the driver's stream, and pass everything that every camera's pass.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from toolee_robot.calibration.record import rows
from toolee_robot.depth_noise import DepthNoise
from toolee_robot.devices.cameras import CameraProfile, CameraStream, Lens, LensModel, RawImages, StatedLens
from toolee_robot.devices.cameras.realsense import RealSenseStream, sdk
from toolee_robot.devices.cameras.stream import CameraMode
from toolee_robot.frames import Array, transform
from toolee_robot.hal import Clock
from toolee_robot.render.depth_sensors import Photo, measure_depth, photograph
from toolee_robot.render.material import Rendering
from toolee_robot.sim_backend.devices.camera import SimCamera
from toolee_robot.sim_backend.devices.software_realsense import BASELINE, Pictures, SoftwareRealSense
from toolee_robot.sim_backend.options import PlacedBoard
from toolee_robot.sim_backend.visuals import SceneState, SceneVisuals, VisualWorld
from toolee_robot.station import CameraConfig, CameraDevice, StationConfig
from toolee_robot.stations.camera import REALSENSE
from toolee_robot.tools import Tool

MARGIN = 2
"""Pixels that are rendered beyond what the lens sees."""


class EmulatedLens:
    """A lens with distortion, in front of the renderer, whose camera is a pinhole.

    Args:
        camera: The camera; it states a distortion.

    Attributes:
        lens: The lens.
        rendered: The camera to render with: the same, with as much more to each side as the lens sees there.
    """

    def __init__(self, camera: CameraConfig) -> None:
        lens = self.lens = lens_of(camera)
        k = lens.intrinsics
        x, y = lens.rays()
        u, v = x * k.fx + k.cx, y * k.fy + k.cy
        left, top = (max(0, int(np.ceil(-low.min()))) + MARGIN for low in (u, v))
        right, bottom = (
            max(0, int(np.ceil(high.max())) - size + 1) + MARGIN for high, size in ((u, k.width), (v, k.height))
        )
        width, height = left + k.width + right, top + k.height + bottom
        self.rendered = replace(camera, cx=k.cx + left, cy=k.cy + top, width=width, height=height)
        self._u, self._v = (u + left).astype(np.float32), (v + top).astype(np.float32)

    def __call__(self, rendering: Rendering) -> Rendering:
        """Distort a rendering.

        Args:
            rendering: What `rendered` sees.

        Returns:
            What the lens shows: colour is interpolated, of all else each pixel has that of the nearest one.
        """
        return Rendering(
            self._remapped(rendering.rgb, cv2.INTER_LINEAR),
            *(
                self._remapped(image, cv2.INTER_NEAREST)
                for image in (rendering.depth, rendering.body_ids, rendering.cos_incidence, rendering.shininess)
            ),
        )

    def _remapped(self, image: NDArray[Any], how: int) -> NDArray[Any]:
        return np.asarray(cv2.remap(image, self._u, self._v, how), image.dtype)


def lens_of(camera: CameraConfig) -> Lens:
    """The lens that a station file states.

    Args:
        camera: The camera.

    Returns:
        The lens; one without distortion where the file states none.
    """
    if camera.distortion is None:
        return Lens(camera.intrinsics)
    return StatedLens(camera.intrinsics, camera.distortion).lens


MILLIMETRE = 1e-3
"""Unit of the depth pictures [m]."""


class ColorAndDepth:
    """Colour and depth camera of one device.

    Colour is seen through the lens; so is depth where it is from the same place. A stereo module's depth has no
    distortion.

    Args:
        visuals: What is there.
        camera: The colour camera.
        lens: Its lens; None for one without distortion.
        X_color_depth: Pose of the depth camera in the colour camera, (4, 4) [m].
        clock: The station's clock.
        seed: Seed of the room.
        rng: Source of the noise.
    """

    def __init__(
        self,
        visuals: VisualWorld,
        camera: CameraConfig,
        lens: EmulatedLens | None,
        X_color_depth: Array,
        clock: Clock,
        seed: int,
        rng: np.random.Generator,
    ) -> None:
        color = camera if lens is None else lens.rendered
        aside = replace(camera, pose=rows(camera.X_base_camera @ X_color_depth))
        views = [color] if np.array_equal(X_color_depth, np.eye(4)) else [color, aside]
        self._cameras = [SimCamera(visuals, clock, view, seed) for view in views]
        self._intrinsics, self._lens, self._rng = camera.intrinsics, lens, rng
        self._renderings: list[Rendering] = []

    @property
    def has_looked(self) -> bool:
        """Whether there is anything to take pictures of."""
        return bool(self._renderings)

    def look(self) -> None:
        """Render what is there now."""
        color, *depth = (camera.render() for camera in self._cameras)
        self._renderings = [color if self._lens is None else self._lens(color), *depth]

    def take(self, least_range: float = 0.0) -> Pictures:
        """Take pictures of what was there at the last look.

        Args:
            least_range: Distance under which nothing has a depth [m].

        Returns:
            Colour, (H, W, 3), and depth, (H, W) [mm].
        """
        color, deep = self._renderings[0], self._renderings[-1]
        metres = measure_depth(
            deep.depth, deep.cos_incidence, deep.shininess, self._intrinsics, DepthNoise(), self._rng
        )
        metres[metres < least_range] = 0.0
        millimetres = np.rint(np.nan_to_num(metres) / MILLIMETRE).clip(0, 2**16 - 1).astype(np.uint16)
        return photograph(color.rgb, Photo(), self._rng), millimetres


STANDS = 3e-4
"""Way of every body between two frames up to which the scene stands still [m]."""


class SeenScene:
    """What the emulated camera sees; frames come while the scene stands still, which is when a job looks.

    Nothing has a depth that is nearer than the station file's `camera.device.least_range`. The lens is the file's.

    Args:
        config: The cell as it is.
        tool: The tool.
        seed: Seed of room and noise.
        state: Returns the poses of everything visible now.
        clock: The station's clock.
        X_color_depth: Pose of the depth camera in the colour camera, (4, 4) [m].
        boards: Calibration boards in the cell.
    """

    def __init__(
        self,
        config: StationConfig,
        tool: Tool,
        seed: int,
        state: Callable[[], SceneState],
        clock: Clock,
        X_color_depth: Array,
        boards: Sequence[PlacedBoard] = (),
    ) -> None:
        assert config.camera.device is not None, "a job needs one"
        camera, self._state, self._least_range = config.camera, state, config.camera.device.least_range
        visuals = SceneVisuals(config, tool, seed, lambda: self._seen, boards)
        lens = EmulatedLens(camera) if lens_of(camera).distorts else None
        rng = np.random.default_rng([seed, 2])
        self._cameras = ColorAndDepth(visuals, camera, lens, X_color_depth, clock, seed, rng)
        self._seen = self._last = state()

    def pictures(self) -> Pictures | None:
        """Colour and depth now; None while something moves."""
        last, now = self._last, self._state()
        self._last = now
        if _way(last, now) > STANDS:
            return None
        if not self._cameras.has_looked or _way(self._seen, now) > STANDS:
            self._seen = now
            self._cameras.look()
        return self._cameras.take(self._least_range)


def _way(before: SceneState, now: SceneState) -> float:
    moved = [
        now.X_base_tool[:3, 3] - before.X_base_tool[:3, 3],
        now.person_center - before.person_center,
        *(X[:3, 3] - before.Xs_base_nail[name][:3, 3] for name, X in now.Xs_base_nail.items()),
        *(X[:3, 3] - before.links[name][:3, 3] for name, X in now.links.items()),
    ]
    return float(np.abs(np.array(moved)).max())


@dataclass
class SceneStream:
    """A `CameraStream` on a scene, for cameras whose SDK has no software device.

    Attributes:
        pictures: What is seen, depth and colour from one place; None while nothing comes.
        config: The camera in the station file.
        device: Its `camera.device`.
        clock: The station's clock.
    """

    pictures: Callable[[], Pictures | None]
    config: CameraConfig
    device: CameraDevice
    clock: Clock

    def open(self) -> CameraProfile:
        """Begin."""
        self._due = self.clock.now()
        model = f"emulated {self.device.driver}"
        # A driver that does not tell its lens: the station file has to.
        lens = Lens(self.config.intrinsics, LensModel.UNKNOWN if lens_of(self.config).distorts else LensModel.NONE)
        return CameraProfile(model, self.device.serial, lens, float(self.device.fps), depth_scale=MILLIMETRE)

    def fetch(self, timeout: float) -> RawImages | None:
        """Wait for the next frame.

        Args:
            timeout: Longest wait [s].

        Returns:
            Its images; None if there is none in time.
        """
        end = self.clock.now() + timeout
        while self.clock.now() < end:
            self._due = max(self._due + 1.0 / self.device.fps, self.clock.now())
            self.clock.sleep(self._due - self.clock.now())
            exposed = self.clock.now()
            if (seen := self.pictures()) is not None:
                return RawImages(*seen, exposed, exposed)
        return None

    def close(self) -> None:
        """End."""


@contextmanager
def emulated_stream(
    camera: CameraConfig, clock: Clock, see: Callable[[Array], Callable[[], Pictures | None]]
) -> Iterator[CameraStream]:
    """Emulate the camera that a station file names.

    Args:
        camera: What the station file says; it names a device. The emulated device tells the same intrinsics.
        clock: The station's clock.
        see: Returns what the camera sees, given the pose of the depth camera in the colour camera, (4, 4) [m].

    Yields:
        The stream for the station's camera: the RealSense driver's own, or one on the scene.

    Raises:
        UserError: The RealSense SDK is not installed.
    """
    device, k = camera.device, camera.intrinsics
    assert device is not None, "a job needs one"
    if device.driver != REALSENSE:
        yield SceneStream(see(np.eye(4)), camera, device, clock)
        return
    rs = sdk()
    coefficients = lens_of(camera).coefficients
    with SoftwareRealSense(
        rs,
        rs.distortion.brown_conrady if coefficients else rs.distortion.none,
        k,
        k,
        coefficients=coefficients,
        serial=device.serial,
        fps=device.fps,
        clock=clock,
        pictures=see(transform(p=[BASELINE, 0.0, 0.0])),
    ) as emulated:
        mode = CameraMode(k.width, k.height, device.fps, device.exposure)
        yield RealSenseStream(device.serial, mode, emulated.devices)
