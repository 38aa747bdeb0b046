"""Which lens holds: the camera's own, the station file's or a measured one; what contradicts each other is refused."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.errors import raises
from toolee_robot.devices.cameras.lens import Lens, LensModel
from toolee_robot.devices.cameras.lens_choice import LensSource, StatedLens, choose_lens
from toolee_robot.errors import NotReadyError
from toolee_robot.types import CameraIntrinsics

PINHOLE = CameraIntrinsics(390.0, 391.0, 213.2, 119.1, 424, 240)
COEFFICIENTS = (0.08, -0.1, 8e-4, -5e-4, 0.02)
KNOWN = Lens(PINHOLE, LensModel.MODIFIED_BROWN_CONRADY, COEFFICIENTS)
UNKNOWN = Lens(PINHOLE, LensModel.UNKNOWN)


def test_without_a_file_the_cameras_own_holds() -> None:
    for told in (KNOWN, UNKNOWN, Lens(PINHOLE)):
        chosen = choose_lens(told, None)
        assert (chosen.lens, chosen.source) == (told, LensSource.CAMERA)
    assert "not known" in choose_lens(UNKNOWN, None).words
    assert "up to 4." in choose_lens(KNOWN, None).words, "its displacement"


@pytest.mark.parametrize("told", [KNOWN, UNKNOWN, Lens(PINHOLE)])
def test_a_file_that_states_no_distortion_must_have_the_cameras_pinhole(told: Lens) -> None:
    assert choose_lens(told, StatedLens(replace(PINHOLE, fx=390.004))).lens == told
    with raises(NotReadyError, "not_ready.camera_intrinsics"):
        choose_lens(told, StatedLens(replace(PINHOLE, fx=390.1)))
    for stated in (
        StatedLens(replace(PINHOLE, width=640)),
        StatedLens(replace(PINHOLE, width=640), COEFFICIENTS, True),
    ):
        with raises(NotReadyError, "not_ready.camera_size"):
            choose_lens(told, stated)


def test_of_a_camera_that_tells_none_the_files_holds() -> None:
    chosen = choose_lens(UNKNOWN, StatedLens(replace(PINHOLE, fx=392.5), COEFFICIENTS))
    assert chosen.source is LensSource.FILE
    assert (chosen.lens.model, chosen.lens.coefficients) == (LensModel.BROWN_CONRADY, COEFFICIENTS)
    assert chosen.lens.intrinsics.fx == 392.5, "focal lengths and distortion are measured together"
    undistorted = choose_lens(UNKNOWN, StatedLens(PINHOLE, (0.0,) * 4))
    assert undistorted.lens.known
    assert not undistorted.lens.distorts
    with raises(NotReadyError, "not_ready.camera_distortion"):
        choose_lens(UNKNOWN, StatedLens(replace(PINHOLE, fx=480.0), COEFFICIENTS))


def test_a_typed_distortion_must_be_the_cameras_own() -> None:
    told = Lens(PINHOLE, LensModel.BROWN_CONRADY, COEFFICIENTS)
    rounded = tuple(round(c, 4) for c in COEFFICIENTS)
    assert choose_lens(told, StatedLens(PINHOLE, rounded)).source is LensSource.CAMERA
    for distortion in ((0.0,) * 4, (-0.08, *COEFFICIENTS[1:])):
        with raises(NotReadyError, "not_ready.camera_distortion"):
            choose_lens(told, StatedLens(PINHOLE, distortion))
    with raises(NotReadyError, "not_ready.camera_distortion"):
        choose_lens(Lens(PINHOLE), StatedLens(PINHOLE, COEFFICIENTS))


@pytest.mark.parametrize("told", [KNOWN, UNKNOWN, Lens(PINHOLE)])
def test_a_record_holds_unless_it_is_another_cameras(told: Lens) -> None:
    measured = StatedLens(replace(PINHOLE, fx=391.5, cx=215.0), (0.07, -0.08, 0.0, 0.0), measured=True)
    chosen = choose_lens(told, measured)
    assert chosen.source is LensSource.RECORD
    assert chosen.lens.intrinsics == measured.intrinsics
    with raises(NotReadyError, "not_ready.camera_distortion"):
        choose_lens(told, replace(measured, intrinsics=replace(PINHOLE, fx=480.0, fy=480.0)))


RECORD = StatedLens(PINHOLE, COEFFICIENTS[:4], measured=True)


@pytest.mark.parametrize("stated", [None, StatedLens(PINHOLE), StatedLens(PINHOLE, COEFFICIENTS), RECORD])
def test_images_that_are_undistorted_are_not_undistorted_again(stated: StatedLens | None) -> None:
    """As a recording's, which the station's own lens undistorted."""
    chosen = choose_lens(Lens(PINHOLE), stated, undistorted=True)
    assert (chosen.lens, chosen.source) == (Lens(PINHOLE), LensSource.RECORDING)
    assert chosen.words == "undistorted when it was recorded"
    if stated is not None:
        with raises(NotReadyError, "not_ready.camera_intrinsics"):
            choose_lens(Lens(PINHOLE), replace(stated, intrinsics=replace(PINHOLE, fx=390.1)), undistorted=True)


def test_where_nobody_knows_whether_images_are_undistorted_no_lens_is_applied() -> None:
    for stated in (None, StatedLens(PINHOLE), StatedLens(PINHOLE, (0.0,) * 4)):
        assert not choose_lens(UNKNOWN, stated, undistorted=None).lens.distorts
    for stated in (StatedLens(PINHOLE, COEFFICIENTS), RECORD):
        with raises(NotReadyError, "not_ready.camera_undistorted"):
            choose_lens(UNKNOWN, stated, undistorted=None)
