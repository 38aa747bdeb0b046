"""Protocol of the camera."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from toolee_robot.hal.device import Device
from toolee_robot.types import CameraIntrinsics, RgbdFrame


@runtime_checkable
class RgbdCamera(Device, Protocol):
    """A calibrated RGB-D camera."""

    @property
    def intrinsics(self) -> CameraIntrinsics:
        """Pinhole model of the undistorted colour image, to which the depth is registered."""

    def read(self, max_age: float = 0.5) -> RgbdFrame:
        """Return a frame that was exposed after the call began; repeated stamps never count as new frames.

        Args:
            max_age: Largest age of the frame [s].

        Raises:
            StaleDataError: No new frame came, or it is older than `max_age`.
            DeviceError: The camera does not answer.
        """
