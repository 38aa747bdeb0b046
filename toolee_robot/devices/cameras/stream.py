"""What a camera's driver gives, and which pairs of its images count as new frames (the frame gate)."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from toolee_robot.devices.cameras.lens import Lens
from toolee_robot.errors import DeviceError, StaleDataError
from toolee_robot.frames import Array

WARM_UP = 15
"""Pairs of images that a device takes to settle: half a second at 30 Hz. Assumed."""


@dataclass(frozen=True)
class CameraMode:
    """What is asked of a camera."""

    width: int
    """Width of the colour image [px]."""
    height: int
    """Height of the colour image [px]."""
    fps: int
    """Frames per second of both images."""
    exposure: float | None = None
    """Exposure of the colour image [s], of a RealSense; None to let the camera choose it."""


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


MAX_DRIFT = 200e-6
"""Largest rate of drift between two clocks. Quartz oscillators are within 50 ppm of their frequency, so two of them
within 100."""


class DeviceClock:
    """Converts stamps of a device's clock to the station's clock.

    An image arrives at `device stamp + offset + delay`. The delay has a least value and is now and then longer, never
    shorter, so the smallest difference of arrival and stamp is the offset plus the least delay. The smallest one seen
    is let rise with MAX_DRIFT, the fastest that clocks drift apart: a minimum filter with a leak, after the clock
    filter of NTP (D. Mills, RFC 5905, section 10), which trusts the samples of the least delay.

    A converted stamp is thus late by the least delay, which no software can see from the stamps alone, and by at most
    MAX_DRIFT times twice the time since an image had it. A stream that becomes late stays seen as late: half a second
    of delay would be forgotten after 40 minutes.
    """

    def __init__(self) -> None:
        self._offset: float | None = None
        self._arrival = 0.0

    def surplus(self, stamp: float, arrival: float) -> float:
        """How much later an image arrives than those of the least delay.

        Args:
            stamp: The image's stamp on the device's clock [s].
            arrival: When it arrived, station's clock [s].

        Returns:
            The surplus [s]; negative where it comes earlier than the drift between the clocks permits, which none of a
            clock that runs evenly does once the least delay was seen.
        """
        if self._offset is None:
            return 0.0
        return arrival - stamp - self._leaked(arrival)

    def convert(self, stamp: float, arrival: float) -> float:
        """Convert a stamp, and learn from it.

        Args:
            stamp: The image's stamp on the device's clock [s].
            arrival: When it arrived, station's clock [s]; not before the last one's.

        Returns:
            The stamp on the station's clock [s]; never after the arrival.
        """
        seen = arrival - stamp
        self._offset = seen if self._offset is None else min(seen, self._leaked(arrival))
        self._arrival = arrival
        return stamp + self._offset

    def _leaked(self, arrival: float) -> float:
        assert self._offset is not None
        return self._offset + MAX_DRIFT * (arrival - self._arrival)


CLOCK_JUMP = 0.1
"""Change of the device's clock against the host's that is no drift [s]."""
LATE = 0.2
"""Delay of a pair beyond the least one from which on it does not count [s]."""
NEAREST, FARTHEST = 0.05, 20.0
"""Range in which the median of the known depths must lie, or its unit is wrong [m]."""


class Refusal(StrEnum):
    """Why a pair of images is no new frame; it is passed over, and the next may be one."""

    WARMING_UP = "the camera has only begun"
    REPEATED = "it repeats a stamp"
    FROZEN = "its picture is frozen: new stamps on the same pixels"
    UNPAIRED = "colour and depth are of different times"
    LATE = "its frames come late"
    SETTLING = "its clock was corrected, which puts this frame before the last one"


class FrameGate:
    """Judges the pairs of images of one stream, in the order in which they arrive.

    A pair counts as a new frame if both images have stamps that are newer than the last ones, of the same time to half
    a frame, pixels that differ from the last ones, since noise makes no two images of a sensor equal, and arrived in
    time. What cannot be is an error and ends the stream: a wrong size or type, a clock that jumps, a depth that cannot
    be in metres.

    Args:
        profile: The opened camera.

    Attributes:
        refused: Number of pairs that were passed over, by reason.
    """

    def __init__(self, profile: CameraProfile) -> None:
        self._profile = profile
        self._clock = DeviceClock()
        self._seen = 0
        self._last: RawImages | None = None
        self._newest = -np.inf
        self.refused: Counter[Refusal] = Counter()

    def admit(self, images: RawImages, arrival: float) -> float | Refusal:
        """Judge a pair of images.

        Args:
            images: The pair.
            arrival: When it arrived, station's clock [s].

        Returns:
            Its stamp on the station's clock [s], or why it is no new frame.

        Raises:
            DeviceError: The images are not what the profile says, the depth's unit is wrong, or the clock jumped.
        """
        verdict = self._judge(images, arrival)
        if isinstance(verdict, Refusal):
            self.refused[verdict] += 1
        return verdict

    def _judge(self, images: RawImages, arrival: float) -> float | Refusal:
        self._check_format(images)
        last, self._last = self._last, images
        stamp = max(images.color_stamp, images.depth_stamp)
        if last is not None:
            if images.color_stamp == last.color_stamp or images.depth_stamp == last.depth_stamp:
                return Refusal.REPEATED
            if min(images.color_stamp - last.color_stamp, images.depth_stamp - last.depth_stamp) < 0:
                raise self._jumped(max(last.color_stamp, last.depth_stamp) - stamp, "back")
        surplus = self._clock.surplus(stamp, arrival)
        if self._seen >= self._profile.warm_up and surplus < -CLOCK_JUMP:
            raise self._jumped(-surplus, "ahead")
        at_station = self._clock.convert(stamp, arrival)
        self._seen += 1
        if abs(images.color_stamp - images.depth_stamp) > 0.5 / self._profile.fps:
            return Refusal.UNPAIRED
        if last is not None and (
            _same(images.rgb, last.rgb) or (images.depth.any() and _same(images.depth, last.depth))
        ):
            return Refusal.FROZEN  # two depth images without a single depth are blind, and equal
        if arrival - at_station > LATE:
            return Refusal.LATE
        if self._seen <= self._profile.warm_up:
            return Refusal.WARMING_UP
        # The older of the two images, so that the frame is not said to be newer than any part of it.
        at_station -= abs(images.color_stamp - images.depth_stamp)
        if at_station <= self._newest:
            return Refusal.SETTLING
        self._newest = at_station
        return at_station

    def _check_format(self, images: RawImages) -> None:
        color = self._profile.color.intrinsics
        depth = (self._profile.depth or self._profile.color).intrinsics
        expected = {"colour": (color.height, color.width, 3), "depth": (depth.height, depth.width)}
        for name, image in (("colour", images.rgb), ("depth", images.depth)):
            if image.shape != expected[name]:
                message = f"the camera's {name} image is {image.shape}, its profile says {expected[name]}: restart it"
                raise DeviceError(message)
        if images.rgb.dtype != np.uint8 or images.depth.dtype not in (np.uint16, np.float32):
            message = f"the camera gives {images.rgb.dtype} colour and {images.depth.dtype} depth: its driver is faulty"
            raise DeviceError(message)
        known = images.depth[::8, ::8]
        known = known[np.isfinite(known) & (known != 0)]
        if known.size:
            scale = self._profile.depth_scale
            median = float(np.median(known)) * scale
            if not NEAREST <= median <= FARTHEST:
                likely = {1e-3: "millimetres taken for metres", 1e3: "metres taken for millimetres"}
                found = [words for factor, words in likely.items() if NEAREST <= factor * median <= FARTHEST]
                raise DeviceError(
                    f"the camera's depths are about {median:.3g} m, with {scale:g} m to a step"
                    f"{''.join(f', which looks like {words}' for words in found)}: correct `depth_scale`. It is "
                    "in metres in the driver's profile, in millimetres in a recording's scene_camera.json",
                    code="device.camera_depth_unit",
                )

    @staticmethod
    def _jumped(by: float, where: str) -> DeviceError:
        return DeviceError(
            f"the camera's clock jumped {where} by {by:.2f} s, so no frame's time is known: open it again"
        )


def stale(refused: Counter[Refusal], max_age: float) -> StaleDataError:
    """The error of a camera that gave no new frame.

    Args:
        refused: The pairs that were passed over meanwhile.
        max_age: The time that was waited [s].

    Returns:
        The error, with the most frequent reason.
    """
    if not refused:
        return StaleDataError(
            f"the camera sent nothing for {max_age:.2f} s: check its cable",
            code="stale_data.camera",
        )
    reason, count = refused.most_common(1)[0]
    code = {
        Refusal.REPEATED: "stale_data.camera_repeats",
        Refusal.FROZEN: "stale_data.camera_frozen",
        Refusal.UNPAIRED: "stale_data.camera_unpaired",
        Refusal.LATE: "stale_data.camera_late",
    }.get(reason, "stale_data.camera")
    return StaleDataError(
        f"the camera gave no new frame within {max_age:.2f} s: {reason} ({count} times). Restart it, and check the "
        "load on this computer and on the camera's port",
        code=code,
    )


def _same(image: NDArray[np.generic], other: NDArray[np.generic]) -> bool:
    # A few rows first: they differ in all but frozen pictures.
    return np.array_equal(image[::37], other[::37]) and np.array_equal(image, other)
