"""A recording, played as if its camera were live."""

from __future__ import annotations

from pathlib import Path

from toolee_robot.devices.cameras.lens import Lens, LensModel
from toolee_robot.devices.cameras.recording import Recording, open_recording
from toolee_robot.devices.cameras.stream import CameraProfile, RawImages
from toolee_robot.errors import NoAnswerError
from toolee_robot.hal import Clock


class RecordedStream:
    """The `CameraStream` of a recording: each frame once, as fast as it was recorded, from its beginning.

    After the last frame nothing comes any more, as from a camera that hangs.

    Args:
        folder: A folder of `toolee camera record`.
        clock: Clock by which it is played.
    """

    def __init__(self, folder: Path, clock: Clock) -> None:
        self._folder, self._clock = folder, clock
        self._recording: Recording | None = None

    def open(self) -> CameraProfile:
        """Open the recording at its beginning.

        Raises:
            UserError: The folder is no recording.
        """
        recording = self._recording = open_recording(self._folder)
        self._next = 0
        self._begin = self._clock.now() - recording.stamps[0]
        return CameraProfile(
            f"recording of {recording.model}",
            recording.serial,
            Lens(recording.intrinsics, LensModel.NONE if recording.undistorted else LensModel.UNKNOWN),
            recording.fps,
            depth_scale=recording.depth_scale,
            warm_up=0,
            undistorted=recording.undistorted,
        )

    def fetch(self, timeout: float) -> RawImages | None:
        """Wait until the next frame is due.

        Args:
            timeout: Longest wait [s].

        Returns:
            Its images; None if none is due in time.

        Raises:
            UserError: They cannot be read.
            NoAnswerError: The recording is closed.
        """
        recording = self._recording
        if recording is None:
            raise NoAnswerError("the recording is closed: open it again", code="no_answer.camera")
        if self._next == len(recording.stamps):
            self._clock.sleep(timeout)
            return None
        stamp = recording.stamps[self._next]
        wait = self._begin + stamp - self._clock.now()
        if wait > timeout:
            self._clock.sleep(timeout)
            return None
        rgb, depth = recording.read(self._next)
        self._clock.sleep(self._begin + stamp - self._clock.now())
        self._next += 1
        return RawImages(rgb, depth, stamp, stamp)

    def close(self) -> None:
        """Close the recording."""
        self._recording = None
