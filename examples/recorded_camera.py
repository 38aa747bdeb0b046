"""A camera driver: `hal.RgbdCamera` on a folder of recorded frames in the BOP layout, played as if they were live.

A driver of a real camera has the same four methods; `read` then waits for the next frame of the device.
"""

from pathlib import Path
from types import TracebackType
from typing import Self

from toolee_robot import CameraIntrinsics, RgbdFrame
from toolee_robot.errors import DeviceError, StaleDataError
from toolee_robot.hal import Clock
from toolee_robot.perception.io import bop_images


class RecordedCamera:
    """Gives each recorded frame once, stamped when it is read. clock: the station's, so that all stamps agree."""

    def __init__(self, folder: Path, clock: Clock) -> None:
        self._images = bop_images(folder)
        self._clock = clock
        self._next = 0
        self._open = False

    def __enter__(self) -> Self:
        self._open = True  # a real driver connects here, and checks model, resolution and registration
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open = False

    @property
    def intrinsics(self) -> CameraIntrinsics:
        """Of the colour image, undistorted; the depth is registered to it."""
        return self._images[0].read().intrinsics

    def read(self, max_age: float = 0.5) -> RgbdFrame:
        """A frame exposed after the call began. Raises StaleDataError when there is none, never repeats an old one."""
        if not self._open:
            raise DeviceError("the camera is closed: read inside its `with` block")
        if self._next == len(self._images):
            self._clock.sleep(max_age)
            raise StaleDataError(f"no new frame within {max_age:.2f} s: the recording is at its end")
        frame = self._images[self._next].read()
        self._next += 1
        return RgbdFrame(frame.rgb, frame.depth, frame.intrinsics, stamp=self._clock.now())
