"""Any RGB-D camera of airo-camera-toolkit (RealSense, ZED, OAK), through its common interface `RGBDCamera`.

    stream = AiroStream(lambda: Zed(resolution=(1280, 720), serial_number=31415926), "31415926")

The toolkit's images carry no stamps and its interface no serial number: a frame's time is that of its fetching, and the
serial number is taken on trust, and it tells no distortion: the station file states that (`camera.distortion`, or a
record in `camera.intrinsics`). A picture that is frozen is still noticed; one that is late is not. Prefer a driver of
this project where there is one. `stations.camera` makes it of a station file.

Written for the toolkit's release 2026.10.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from toolee_robot.devices.cameras.lens import Lens, LensModel
from toolee_robot.devices.cameras.stream import CameraProfile, RawImages
from toolee_robot.errors import NoAnswerError, words_of
from toolee_robot.types import CameraIntrinsics


class AiroStream:
    """The `CameraStream` of a camera of the toolkit.

    Args:
        make: Constructs the toolkit's camera, which opens it.
        serial: Serial number of the camera that it opens.
    """

    def __init__(self, make: Callable[[], Any], serial: str) -> None:
        self._make, self._serial = make, serial
        self._camera: Any = None

    def open(self) -> CameraProfile:
        """Construct and enter the camera.

        Raises:
            NoAnswerError: It cannot be opened.
        """
        try:
            camera = self._make().__enter__()
            (fx, _, cx), (_, fy, cy), _ = np.asarray(camera.intrinsics_matrix(), np.float64).tolist()
            width, height = camera.resolution
            fps = float(camera.fps)
        except Exception as error:  # whatever a maker's library raises
            what = f"airo-camera-toolkit cannot open the camera {self._serial}"
            message = f"{what} ({words_of(error)}): check cable and settings"
            raise NoAnswerError(message) from error
        self._camera = camera
        lens = Lens(CameraIntrinsics(fx, fy, cx, cy, int(width), int(height)), LensModel.UNKNOWN)
        return CameraProfile(type(camera).__name__, self._serial, lens, fps)

    def fetch(self, timeout: float) -> RawImages | None:  # noqa: ARG002  # the toolkit waits as long as it wants
        """Grab the next pair; it waits as long as the toolkit does.

        Args:
            timeout: Not used.

        Returns:
            The pair, with the time at which it came.

        Raises:
            NoAnswerError: The camera is closed, or the toolkit failed.
        """
        if self._camera is None:
            raise NoAnswerError("the camera is closed: open it again")
        try:
            self._camera.grab_images()
            stamp = time.monotonic()
            rgb = np.array(self._camera.retrieve_rgb_image_as_int(), np.uint8)
            depth = np.array(self._camera.retrieve_depth_map(), np.float32)
        except Exception as error:  # whatever a maker's library raises
            message = (
                f"airo-camera-toolkit gave no image of the camera {self._serial} ({words_of(error)}): plug it in again"
            )
            raise NoAnswerError(message, code="no_answer.camera_unplugged") from error
        depth[~np.isfinite(depth)] = 0.0
        return RawImages(rgb, depth, stamp, stamp)

    def close(self) -> None:
        """Leave the camera's context."""
        camera, self._camera = self._camera, None
        if camera is not None:
            camera.__exit__(None, None, None)
