"""A driver of your own camera: a `CameraStream` around whatever its maker's library grabs.

Connects, says what the camera is, and fetches; `StreamedCamera` does what must hold for every camera.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from toolee_robot import CameraIntrinsics
from toolee_robot.devices.cameras import CameraProfile, CameraStream, Lens, LensModel, RawImages
from toolee_robot.errors import NoAnswerError
from toolee_robot.hal import Clock
from toolee_robot.station import CameraConfig, CameraDevice

COLOR = Lens(CameraIntrinsics(525.0, 525.0, 319.5, 239.5, 640, 480), LensModel.BROWN_CONRADY, (0.05, -0.1, 0, 0, 0))
DEPTH = Lens(CameraIntrinsics(570.0, 570.0, 319.5, 239.5, 640, 480))  # a real driver asks its device for these
X_COLOR_DEPTH = np.array([[1.0, 0, 0, 0.025], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


class OwnCameraStream:
    """`grab` waits up to a time [s] for colour, depth [mm] and the device's stamp [s]; None where nothing came."""

    def __init__(self, grab: Callable[[float], tuple[Any, Any, float] | None], serial: str) -> None:
        self._grab, self._serial = grab, serial

    def open(self) -> CameraProfile:
        """Connect here. Without `depth` and `X_color_depth` the device is taken to register its depth itself."""
        return CameraProfile("own camera", self._serial, COLOR, 30.0, DEPTH, X_COLOR_DEPTH, depth_scale=0.001)

    def fetch(self, timeout: float) -> RawImages | None:
        """The next pair, however old: which of them counts is judged elsewhere."""
        try:
            grabbed = self._grab(timeout)
        except OSError as error:
            message = f"the camera {self._serial} is gone ({error}): plug it in, and open it again"
            raise NoAnswerError(message, code="no_answer.camera_unplugged") from error
        if grabbed is None:
            return None
        rgb, depth, stamp = grabbed
        return RawImages(np.array(rgb, np.uint8), np.array(depth, np.uint16), stamp, stamp)

    def close(self) -> None:
        """Disconnect here."""


def open_stream(config: CameraConfig, device: CameraDevice, clock: Clock) -> CameraStream:
    """What the entry point names. config, device: of the station file; clock: the station's."""
    raise NotImplementedError("connect the maker's library here, and return OwnCameraStream(grab, device.serial)")


if __name__ == "__main__":
    print(__doc__)
