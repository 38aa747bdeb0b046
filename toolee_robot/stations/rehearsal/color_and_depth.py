"""The colour and the depth camera of an emulated device, and the pictures that they take."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from toolee_robot.calibration.record import rows
from toolee_robot.depth_noise import DepthNoise
from toolee_robot.frames import Array
from toolee_robot.hal import Clock
from toolee_robot.render.scene import Rendering
from toolee_robot.render.sensors.color_camera import Photo, photograph
from toolee_robot.render.sensors.depth_camera import measure_depth
from toolee_robot.sim_backend.devices.camera import SimCamera
from toolee_robot.sim_backend.devices.software_realsense import Pictures
from toolee_robot.sim_backend.visuals.visual_body import VisualWorld
from toolee_robot.station import CameraConfig
from toolee_robot.stations.rehearsal.lens import EmulatedLens

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
