"""A job looks for the hammer about the hand that holds it, as wide as handover and calibration leave it uncertain."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.frames import Array, inverse, transform
from toolee_robot.perception import Segmenter, ToolPerception
from toolee_robot.perception.detection.passes import Crop
from toolee_robot.sim_backend.devices.operator import handed_over
from toolee_robot.sim_backend.options import InHandOffset
from toolee_robot.sim_backend.station import SimStation
from toolee_robot.station import sim_station
from toolee_robot.station.calibration import SIMULATED_CALIBRATION
from toolee_robot.tasks.common.held_tool import POSE_ERRORS, held_region
from toolee_robot.tasks.common.look import largest_displacement
from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.tasks.hammering.grasp import nominal_grasp
from toolee_robot.tasks.hammering.task import HammeringTask
from toolee_robot.types import Detection, RgbdFrame, ToolEstimate

pytestmark = pytest.mark.sim(seconds=40)


class Watched:
    """The shipped detector, and what it was asked."""

    def __init__(self) -> None:
        self._segmenter = Segmenter.load()
        self.asked: list[tuple[list[Category], Crop | None]] = []

    def detect(
        self, frame: RgbdFrame, categories: Sequence[Category] = CATEGORIES, crop: Crop | None = None
    ) -> list[Detection]:
        self.asked.append((list(categories), crop))
        return self._segmenter.detect(frame, categories, crop)


class Enough(Exception):
    """Ends the job."""


class FirstFrame(TaskObserver):
    def __init__(self) -> None:
        self.seen: list[tuple[RgbdFrame, list[ToolEstimate], Array]] = []

    def frame(self, frame: RgbdFrame, estimates: list[ToolEstimate], X_camera_hand: Array) -> None:
        self.seen.append((frame, estimates, X_camera_hand))
        raise Enough


@pytest.mark.nightly
def test_a_job_finds_the_face_in_a_crop_about_the_hand_alone() -> None:
    config, observer, detector = sim_station(), FirstFrame(), Watched()
    shipped = ToolPerception.load()
    with SimStation.build(config, 100) as sim:
        perception = ToolPerception(detector, shipped.pose, shipped.trust)
        grasp = nominal_grasp(sim.tool, config)
        with suppress(Enough):
            HammeringTask(sim.station, perception, config, grasp, observer=observer).run()
        ((frame, estimates, X_camera_hand),) = observer.seen
        X_hand_face = sim.judge.X_hand_ee(frame.stamp)
    ((categories, crop),) = detector.asked
    assert categories == [Category.HAMMER_HEAD]
    assert crop is not None
    assert (crop.x1 - crop.x0) * (crop.y1 - crop.y0) < 0.6 * frame.depth.size
    best = estimates[0]
    assert best.usable
    error = inverse(X_hand_face) @ inverse(X_camera_hand) @ best.X_camera_ee
    assert np.linalg.norm(error[:3, 3]) < 5e-3
    assert error[2, 2] > np.cos(np.deg2rad(5.0)), "the face's normal"


def test_the_region_is_as_wide_as_the_calibration_is_uncertain() -> None:
    X_hand_ee = transform(p=[0.08, 0.0, 0.2])
    station = sim_station()
    largest = largest_displacement(X_hand_ee)
    exact = held_region(station, X_hand_ee, largest)
    measured = replace(SIMULATED_CALIBRATION, residual=0.0025)
    lab = held_region(replace(station, calibration=measured), X_hand_ee, largest)
    assert lab.radius - exact.radius == pytest.approx(POSE_ERRORS * 0.0025)
    np.testing.assert_array_equal(lab.points, exact.points)
    assert exact.radius > largest + station.tool_envelope.head_radius - 1e-9
    for point in (X_hand_ee[:3, 3], np.zeros(3)):
        assert np.linalg.norm(exact.points - point, axis=1).min() < 1e-9, "face and hand"


@settings(max_examples=200, deadline=None)
@given(seed=st.integers(0, 2**31 - 1), lever=st.floats(0.15, 0.32))
def test_no_hammer_that_the_simulated_person_hands_over_is_implausible(seed: int, lever: float) -> None:
    # The face as it lies in the hand: along the handle by the lever, beside it by a head of 60 mm.
    X_hand_tool, X_tool_ee = np.eye(4), transform(p=[0.06, 0.0, lever])
    offset = InHandOffset.draw(np.random.default_rng(seed))
    nominal = X_hand_tool @ X_tool_ee
    face = handed_over(X_hand_tool, offset) @ X_tool_ee
    assert np.linalg.norm(face[:3, 3] - nominal[:3, 3]) <= largest_displacement(nominal)
