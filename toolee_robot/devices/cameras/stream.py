"""What a camera's driver gives: its profile, and the raw images of its stream."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from toolee_robot.devices.cameras.lens import Lens
from toolee_robot.frames import Array

WARM_UP = 15
"""Pairs of images that a device takes to settle: half a second at 30 Hz. Assumed."""


@dataclass(frozen=True, eq=False)
class CameraProfile:
    """An opened camera.

    Attributes:
        model: Name of the model.
        serial: Serial number, as the device reports it.
        color: Lens of the colour images; its model is `LensModel.UNKNOWN` where the driver cannot tell.
        fps: Frames per second.
        depth: Lens of the depth images; None where they are registered to the colour images, whose lens they share.
        X_color_depth: Pose of the depth camera in the colour camera, (4, 4) [m]; None with `depth`.
        depth_scale: Metres per unit of the depth images.
        auto_exposure: Whether the device sets the exposure by itself; None where it cannot say.
        firmware: Its version; empty where unknown.
        warm_up: Pairs of images after opening that do not count: until the exposure has settled and the least delay of
            the images was seen.
        undistorted: Whether the lens's distortion was taken out of the images before, as in a recording, so that no
            station file's lens is applied to them; None where nobody knows.
    """

    model: str
    serial: str
    color: Lens
    fps: float
    depth: Lens | None = None
    X_color_depth: Array | None = None
    depth_scale: float = 1.0
    auto_exposure: bool | None = None
    firmware: str = ""
    warm_up: int = WARM_UP
    undistorted: bool | None = False


@dataclass(frozen=True, eq=False)
class RawImages:
    """One pair of a stream's images.

    Attributes:
        rgb: Colour image, (H, W, 3) uint8, as the lens gives it.
        depth: Depth image, (h, w), in units of `CameraProfile.depth_scale`; 0 where unknown.
        color_stamp: Time of the colour image on the device's clock [s].
        depth_stamp: Time of the depth image on the same clock [s].
    """

    rgb: NDArray[np.uint8]
    depth: NDArray[Any]
    color_stamp: float
    depth_stamp: float


class CameraStream(Protocol):
    """A camera's driver. `StreamedCamera` makes a `hal.RgbdCamera` of it and calls it from one thread at a time.

    It only fetches: what has to be done to the images, and what must not be believed, is the same for every camera.
    """

    def open(self) -> CameraProfile:
        """Connect, start the stream and say what it is.

        Raises:
            NoAnswerError: The camera is not there, or does not answer.
            NotReadyError: It cannot give what is asked of it.
        """

    def fetch(self, timeout: float) -> RawImages | None:
        """Wait for the next pair of images.

        Args:
            timeout: Longest wait [s].

        Returns:
            The pair; None where none came in time.

        Raises:
            NoAnswerError: The camera is gone.
        """

    def close(self) -> None:
        """Stop the stream; nothing is raised where the camera is gone."""
