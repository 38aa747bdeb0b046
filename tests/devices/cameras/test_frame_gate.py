"""Which pairs of images count as new frames, and what is an error."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.errors import raises
from tests.examples import examples
from toolee_robot.devices.cameras import CameraProfile, Lens, RawImages
from toolee_robot.devices.cameras.stream import MAX_DRIFT, DeviceClock, FrameGate, Refusal
from toolee_robot.errors import DeviceError
from toolee_robot.types import CameraIntrinsics

PROFILE = CameraProfile("toy", "1", Lens(CameraIntrinsics(60.0, 60.0, 32.0, 24.0, 64, 48)), 30.0, depth_scale=1e-3)
PERIOD, DELAY = 1 / 30, 0.03


def pairs(seed: int = 0, begin: float = 50.0) -> Iterator[RawImages]:
    rng = np.random.default_rng(seed)
    n = 0
    while True:
        rgb = rng.integers(0, 255, (48, 64, 3)).astype(np.uint8)
        depth = rng.integers(700, 900, (48, 64)).astype(np.uint16)
        yield RawImages(rgb, depth, begin + n * PERIOD, begin + n * PERIOD)
        n += 1


@pytest.fixture
def stream() -> Iterator[RawImages]:
    return pairs()


@pytest.fixture
def gate(stream: Iterator[RawImages]) -> FrameGate:
    gate = FrameGate(PROFILE)
    for _ in range(PROFILE.warm_up):
        images = next(stream)
        assert gate.admit(images, images.color_stamp + DELAY) is Refusal.WARMING_UP
    return gate


def test_new_frames_pass_with_their_own_stamps(gate: FrameGate, stream: Iterator[RawImages]) -> None:
    for late in (0.0, 0.01, 0.15, 0.0):
        images = next(stream)
        stamp = gate.admit(images, images.color_stamp + DELAY + late)
        assert isinstance(stamp, float)
        assert abs(stamp - (images.color_stamp + DELAY)) < 1e-4, "jitter of the arrival does not count"


def change(images: RawImages, **values: object) -> RawImages:
    fields = {"rgb": images.rgb, "depth": images.depth}
    stamps = {"color_stamp": images.color_stamp, "depth_stamp": images.depth_stamp}
    return RawImages(**{**fields, **stamps, **values})  # type: ignore[arg-type]


def test_repeated_frozen_unpaired_and_late_pairs_are_passed_over(gate: FrameGate, stream: Iterator[RawImages]) -> None:
    first = next(stream)
    assert isinstance(gate.admit(first, first.color_stamp + DELAY), float)
    assert gate.admit(first, first.color_stamp + DELAY + PERIOD) is Refusal.REPEATED
    second = change(next(stream), rgb=first.rgb.copy())
    assert gate.admit(second, second.color_stamp + DELAY) is Refusal.FROZEN
    third = change(next(stream), depth=second.depth.copy())
    assert gate.admit(third, third.color_stamp + DELAY) is Refusal.FROZEN
    fourth = next(stream)
    fourth = change(fourth, depth_stamp=fourth.depth_stamp - 0.6 * PERIOD)
    assert gate.admit(fourth, fourth.color_stamp + DELAY) is Refusal.UNPAIRED
    fifth = next(stream)
    assert gate.admit(fifth, fifth.color_stamp + DELAY + 0.25) is Refusal.LATE
    sixth = next(stream)
    sixth = change(sixth, depth_stamp=sixth.depth_stamp - 0.4 * PERIOD)
    stamp = gate.admit(sixth, sixth.color_stamp + DELAY + 0.1)
    assert isinstance(stamp, float)
    assert abs(stamp - (sixth.depth_stamp + DELAY)) < 1e-3, "that of the older image"
    assert gate.refused[Refusal.FROZEN] == 2
    assert gate.refused[Refusal.REPEATED] == gate.refused[Refusal.UNPAIRED] == gate.refused[Refusal.LATE] == 1


def test_a_covered_depth_camera_is_not_frozen(gate: FrameGate, stream: Iterator[RawImages]) -> None:
    for _ in range(2):
        images = change(next(stream), depth=np.zeros((48, 64), np.uint16))
        assert isinstance(gate.admit(images, images.color_stamp + DELAY), float)


@pytest.mark.parametrize("jump", [-3.0, 0.5, 1e6])
def test_a_clock_that_jumps_is_an_error(gate: FrameGate, stream: Iterator[RawImages], jump: float) -> None:
    images = next(stream)
    arrival = images.color_stamp + DELAY
    jumped = change(images, color_stamp=images.color_stamp + jump, depth_stamp=images.depth_stamp + jump)
    with raises(DeviceError, says="the camera's clock jumped"):
        gate.admit(jumped, arrival)


@pytest.mark.parametrize(
    ("values", "code"),
    [
        ({"rgb": np.zeros((24, 64, 3), np.uint8)}, "device"),
        ({"rgb": np.zeros((48, 64), np.uint8)}, "device"),
        ({"rgb": np.zeros((48, 64, 3), np.uint16)}, "device"),
        ({"depth": np.ones((24, 32), np.uint16)}, "device"),
        ({"depth": np.full((48, 64), 800.0)}, "device"),
        ({"depth": np.full((48, 64), 8, np.uint16)}, "device.camera_depth_unit"),
        ({"depth": np.full((48, 64), 60_000, np.uint16)}, "device.camera_depth_unit"),
        ({"depth": np.full((48, 64), -800.0, np.float32)}, "device.camera_depth_unit"),
    ],
)
def test_images_that_cannot_be_are_an_error(
    gate: FrameGate, stream: Iterator[RawImages], values: dict[str, object], code: str
) -> None:
    images = change(next(stream), **values)
    with raises(DeviceError, code):
        gate.admit(images, images.color_stamp + DELAY)


@examples(30)
@given(st.lists(st.sampled_from(["new", "repeat", "frozen", "late", "lost"]), max_size=40), st.integers(0, 100))
def test_no_old_picture_passes_whatever_happens(events: list[str], seed: int) -> None:
    stream, gate = pairs(seed), FrameGate(PROFILE)
    for _ in range(PROFILE.warm_up):
        last = next(stream)
        gate.admit(last, last.color_stamp + DELAY)
    passed: list[float] = []
    for event in events:
        images = last if event == "repeat" else next(stream)
        if event == "lost":
            continue
        if event == "frozen":
            images = change(images, rgb=last.rgb)
        verdict = gate.admit(images, images.color_stamp + DELAY + (0.3 if event == "late" else 0.0))
        assert isinstance(verdict, float) == (event == "new"), (event, verdict)
        if isinstance(verdict, float):
            passed.append(verdict)
        last = images
    assert passed == sorted(set(passed))


PERIOD_DEVICE_CLOCK = 1 / 30


@examples(60)
@given(
    drift=st.floats(-100e-6, 100e-6),
    offset=st.floats(-1e5, 1e5),
    least=st.floats(0.0, 0.05),
    jitter=st.floats(0.0, 0.1),
    seed=st.integers(0, 2**31),
)
def test_a_stamp_is_late_by_the_least_delay_and_little_more(
    drift: float, offset: float, least: float, jitter: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    exposed = 100.0 + PERIOD_DEVICE_CLOCK * np.arange(600) + 0.01 * rng.random(600)
    extra = jitter * rng.random(600) ** 2
    arrivals = np.maximum.accumulate(exposed + least + extra)
    clock = DeviceClock()
    error = np.array(
        [clock.convert((1 + drift) * t + offset, a) - (t + least) for t, a in zip(exposed, arrivals, strict=True)]
    )
    extra = arrivals - exposed - least
    slack = 1e-6 + 1e-9 * abs(offset)
    # Between the clocks and the truth: what they drift apart since the image with the least delay.
    passed = exposed[:, None] - exposed[None, :]
    bound = np.where(passed >= 0, extra[None, :] + 2 * MAX_DRIFT * (passed + least + jitter), np.inf).min(axis=1)
    assert np.all(error <= bound + slack)
    assert np.all(error >= -2 * MAX_DRIFT * (least + jitter) - slack), "never before the exposure and the least delay"
    assert np.all(error + exposed + least <= arrivals + slack), "never after the arrival"


def test_it_is_within_a_millisecond_under_ten_minutes_of_jitter_and_drift() -> None:
    rng = np.random.default_rng(1)
    exposed = PERIOD_DEVICE_CLOCK * np.arange(18_000)
    arrivals = np.maximum.accumulate(exposed + 0.025 + rng.exponential(0.008, 18_000))
    clock = DeviceClock()
    stamps = 1e4 + exposed * (1 - 80e-6)
    error = np.array([clock.convert(s, a) for s, a in zip(stamps, arrivals, strict=True)]) - exposed - 0.025
    assert np.abs(error[30:]).max() < 2e-3
    assert np.median(np.abs(error)) < 0.7e-3


def test_a_stream_that_becomes_late_stays_late() -> None:
    clock = DeviceClock()
    for n in range(100):
        clock.convert(PERIOD_DEVICE_CLOCK * n, PERIOD_DEVICE_CLOCK * n + 0.02)
    for n in range(100, 1900):
        stamp = clock.convert(PERIOD_DEVICE_CLOCK * n, PERIOD_DEVICE_CLOCK * n + 0.52)
    assert abs(stamp - (PERIOD_DEVICE_CLOCK * 1899 + 0.02)) < 0.02
