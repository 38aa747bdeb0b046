"""Any camera's driver as a `hal.RgbdCamera`: new frames only, undistorted, the depth registered to the colour."""

from __future__ import annotations

import threading
from collections import Counter
from dataclasses import dataclass
from typing import Self

import numpy as np

from toolee_robot.devices.cameras.lens import DepthRegistration
from toolee_robot.devices.cameras.lens_choice import ChosenLens, StatedLens, choose_lens
from toolee_robot.devices.cameras.stream import CameraProfile, CameraStream, FrameGate, RawImages, Refusal, stale
from toolee_robot.errors import DeviceError, NoAnswerError, NotReadyError, TooleeError, words_of
from toolee_robot.hal import Clock
from toolee_robot.types import CameraIntrinsics, RgbdFrame

LATENCY = 0.1
"""Longest time from exposure to arrival that a frame without any delay may have [s], which its stamp does not show
(`DeviceClock`). Assumed: three frames of a camera at 30 Hz."""
OPENING_TIME = 5.0
"""Time for the first new frame after opening [s]."""
FETCH_TIME = 0.2
"""Longest wait of the reading thread at a time [s]."""


@dataclass(frozen=True, eq=False)
class _Arrived:
    images: RawImages
    """A new pair."""
    stamp: float
    """Its stamp on the station's clock [s]."""


class StreamedCamera:
    """A camera on its stream; use it in its `with` block.

    A thread fetches every pair of images and passes it through the frame gate, so that nothing queues, the clocks are
    followed and a camera that is gone is noticed; `read` waits for a new one, undistorts its colour, and registers its
    depth, or undistorts it by the same map. An error of the stream is kept: every `read` raises it until the camera is
    opened again.

    Args:
        stream: The camera's driver.
        clock: The station's clock, the host's.
        stated: What the station file states of the lens; None to take what the camera says.
        serial: Serial number that the camera must have; None for any.
    """

    def __init__(
        self, stream: CameraStream, clock: Clock, stated: StatedLens | None = None, serial: str | None = None
    ) -> None:
        self._stream, self._clock, self._stated, self._serial = stream, clock, stated, serial
        self._profile: CameraProfile | None = None
        self._news = threading.Condition()
        self._newest: _Arrived | None = None
        self._error: TooleeError | None = None
        self._thread: threading.Thread | None = None
        self._gate: FrameGate | None = None
        self._closing = threading.Event()

    def __enter__(self) -> Self:
        """Open the camera and wait for its first new frame.

        Raises:
            NoAnswerError: It is not there.
            NotReadyError: It is another camera, cannot give what is asked, or its lens is not the station file's
                (`choose_lens`).
            StaleDataError: No new frame came.
            DeviceError: What it gives cannot be used.
        """
        self._newest, self._error = None, None
        self._closing.clear()
        profile = self._profile = self._stream.open()
        try:
            if self._serial not in (None, profile.serial):
                raise NotReadyError(
                    f"the camera's serial number is {profile.serial!r}, the station file's {self._serial!r}: connect "
                    "the calibrated camera, or calibrate this one and change camera.device.serial",
                    code="not_ready.camera_serial",
                )
            chosen = self._lens = choose_lens(profile.color, self._stated, undistorted=profile.undistorted)
            self._undistort = chosen.lens.undistortion() if chosen.lens.distorts else None
            self._register = None
            if profile.depth is not None and profile.X_color_depth is not None:
                self._register = DepthRegistration(profile.depth, chosen.lens.intrinsics, profile.X_color_depth)
            gate = self._gate = FrameGate(profile)
            name = f"camera {profile.serial}"
            self._thread = threading.Thread(target=self._run, args=(gate,), name=name, daemon=True)
            self._thread.start()
            self._wait(after=-np.inf, max_age=OPENING_TIME)
        except BaseException:
            self._close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """Stop the stream and release the camera."""
        self._close()

    @property
    def profile(self) -> CameraProfile:
        """What the opened camera is.

        Raises:
            DeviceError: It is closed.
        """
        if self._profile is None:
            raise DeviceError("the camera is closed: use it inside its `with` block", code="device.closed")
        return self._profile

    @property
    def intrinsics(self) -> CameraIntrinsics:
        """Pinhole model of the undistorted colour image, to which the depth is registered.

        Raises:
            DeviceError: The camera is closed.
        """
        return self.lens.lens.intrinsics

    @property
    def lens(self) -> ChosenLens:
        """The lens by which the images are undistorted, and where it is from.

        Raises:
            DeviceError: The camera is closed.
        """
        _ = self.profile  # open
        return self._lens

    @property
    def refused(self) -> Counter[Refusal]:
        """Number of the pairs of images since the opening that were no new frames, by reason."""
        return Counter() if self._gate is None else Counter(self._gate.refused)

    def read(self, max_age: float = 0.5) -> RgbdFrame:
        """Wait for a frame that was exposed after the call began.

        Args:
            max_age: Longest wait, and the frame's largest age [s].

        Returns:
            The frame. Its stamp is the camera's own, converted to the station's clock; it is late by the least delay of
            the camera's frames, which is taken to be under LATENCY.

        Raises:
            StaleDataError: No new frame came; its code says what came instead.
            NoAnswerError: The camera is gone.
            DeviceError: It is closed, or what it gave cannot be used.
        """
        return self._frame(self._wait(self._clock.now() + LATENCY, max_age))

    def newer(self, stamp: float, max_age: float = 0.5) -> RgbdFrame:
        """Wait for a frame after another one: for recordings and measurements, where every frame counts.

        Args:
            stamp: Stamp of the other frame, station's clock [s].
            max_age: Longest wait, and the frame's largest age [s].

        Returns:
            The newest frame; it may have been exposed before the call.

        Raises:
            StaleDataError: As `read`.
            NoAnswerError: As `read`.
            DeviceError: As `read`.
        """
        return self._frame(self._wait(np.nextafter(stamp, np.inf), max_age))

    def _frame(self, arrived: _Arrived) -> RgbdFrame:
        profile, images = self.profile, arrived.images
        rgb = images.rgb if self._undistort is None else self._undistort.color(images.rgb)
        depth = images.depth.astype(np.float32) * np.float32(profile.depth_scale)
        depth[~np.isfinite(depth)] = 0.0
        if self._register is not None:
            depth = self._register(depth)
        elif self._undistort is not None:
            depth = self._undistort.depth(depth)
        return RgbdFrame(np.ascontiguousarray(rgb), depth, self._lens.lens.intrinsics, arrived.stamp)

    def _wait(self, after: float, max_age: float) -> _Arrived:
        """Wait for a frame whose stamp is not before `after`."""
        _ = self.profile  # open
        before = self.refused
        end = self._clock.now() + max_age
        with self._news:
            while True:
                if self._error is not None:
                    raise self._error.with_traceback(None)
                newest, now = self._newest, self._clock.now()
                if newest is not None and newest.stamp >= after and now - newest.stamp <= max_age:
                    return newest
                if now >= end:
                    raise stale(self.refused - before, max_age)
                self._news.wait(min(0.05, max(1e-3, end - now)))

    def _run(self, gate: FrameGate) -> None:
        """In the camera's thread: fetch, judge, keep the newest."""
        try:
            while not self._closing.is_set():
                images = self._stream.fetch(FETCH_TIME)
                if images is None:
                    continue
                verdict = gate.admit(images, self._clock.now())
                if isinstance(verdict, Refusal):
                    continue
                with self._news:
                    self._newest = _Arrived(images, verdict)
                    self._news.notify_all()
        except TooleeError as error:
            self._fail(error)
        except Exception as error:  # noqa: BLE001  # whatever a maker's library raises: the reader must hear of it
            self._fail(NoAnswerError(f"the camera's driver failed: {words_of(error)}: open it again"))

    def _fail(self, error: TooleeError) -> None:
        with self._news:
            self._error = error
            self._news.notify_all()

    def _close(self) -> None:
        self._closing.set()
        if self._thread is not None:
            self._thread.join()
        self._thread, self._profile = None, None
        self._stream.close()
