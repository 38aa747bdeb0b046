"""The emulated camera of a rehearsal: the simulated world, rendered and with the sensors' noise.

A RealSense's pictures go through its maker's SDK as a software device. The other makers' SDKs have none: there the
pictures come in at the place of the driver's stream, and pass everything that every camera's pass.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from toolee_robot.calibration.record import rows
from toolee_robot.config import CameraConfig, CameraDevice, StationConfig
from toolee_robot.depth_noise import DepthNoise
from toolee_robot.frames import Array, transform
from toolee_robot.hal import Clock
from toolee_robot.hardware.cameras import CameraProfile, CameraStream, Lens, LensModel, RawImages
from toolee_robot.hardware.cameras.realsense import RealSenseMode, RealSenseStream, sdk
from toolee_robot.render.scene import Rendering
from toolee_robot.render.sensors.color_camera import Photo, photograph
from toolee_robot.render.sensors.depth_camera import measure_depth
from toolee_robot.sim_backend.devices.camera import SimCamera
from toolee_robot.sim_backend.devices.software_realsense import BASELINE, Pictures, SoftwareRealSense
from toolee_robot.sim_backend.options import PlacedBoard
from toolee_robot.sim_backend.visuals.scene import SceneState, SceneVisuals
from toolee_robot.stations.camera import REALSENSE
from toolee_robot.stations.rehearsal.lens import EmulatedLens, lens_of
from toolee_robot.tools import Tool

STANDS = 3e-4
"""Way of every body between two frames up to which the scene stands still [m]."""
MILLIMETRE = 1e-3


class SeenScene:
    """What the emulated camera sees; frames come while the scene stands still, which is when a job looks.

    Nothing has a depth that is nearer than the station file's `camera.device.least_range`. Colour is seen through the
    lens that the file states; so is depth where it is from the same place. A stereo module's depth has no distortion.

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
        self._state, self._intrinsics = state, config.camera.intrinsics
        self._least_range = config.camera.device.least_range
        visuals = SceneVisuals(config, tool, seed, lambda: self._seen, boards)
        distorts = lens_of(config.camera).distorts
        self._lens = EmulatedLens(config.camera) if distorts else None
        color = config.camera if self._lens is None else self._lens.rendered
        aside = replace(config.camera, pose=rows(config.camera.X_base_camera @ X_color_depth))
        views = [color] if np.array_equal(X_color_depth, np.eye(4)) else [color, aside]
        self._cameras = [SimCamera(visuals, clock, view, seed) for view in views]
        self._rng = np.random.default_rng([seed, 2])
        self._renderings: list[Rendering] = []
        self._seen = self._last = state()

    def pictures(self) -> Pictures | None:
        """Colour and depth now; None while something moves."""
        last, now = self._last, self._state()
        self._last = now
        if _way(last, now) > STANDS:
            return None
        if not self._renderings or _way(self._seen, now) > STANDS:
            self._seen = now
            rendered, *others = (camera.render() for camera in self._cameras)
            self._renderings = [rendered if self._lens is None else self._lens(rendered), *others]
        color, depth = self._renderings[0], self._renderings[-1]
        metres = measure_depth(
            depth.depth, depth.cos_incidence, depth.shininess, self._intrinsics, DepthNoise(), self._rng
        )
        metres[metres < self._least_range] = 0.0
        millimetres = np.rint(np.nan_to_num(metres) / MILLIMETRE).clip(0, 2**16 - 1).astype(np.uint16)
        return photograph(color.rgb, Photo(), self._rng), millimetres


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
        mode = RealSenseMode(k.width, k.height, device.fps, device.exposure)
        yield RealSenseStream(device.serial, mode, emulated.devices)
