"""What is entered in the station file of a nail that was located."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.errors import raises
from toolee_robot.app.calibrate_nail import Located, Sight, mistake
from toolee_robot.calibration.nail import SeenNail
from toolee_robot.errors import ConfigError
from toolee_robot.station import WorkConfig, load_station, sim_station

WORK = sim_station().work
ARM = "version: 3\nframe: base_link\narm: {model: UR10, up: [0, 0, 1]}\n"


def _located(lab: Path, true: WorkConfig, name: str = "") -> Located:
    """The nail of `true`, as a look without errors finds it."""
    config = load_station(lab)
    name = name or config.work.names[0]
    seen = SeenNail(true.p_base_entry, 1e-6 * np.eye(3), true.wood_normal, 0.0, 1e-3, 20, 0.2)
    return Located(replace(config, work=config.work.only(name)), name, Sight(seen))


@pytest.mark.parametrize("frame", ["base_link", "pendant_base"])
def test_nail_and_wood_are_entered_in_the_files_frame(tmp_path: Path, frame: str) -> None:
    true = replace(WORK, nail_xy=(0.752, 0.099), stand_height=0.203, wood_rise=(0.02, -0.03), nail_lean=(0.01, 0.02))
    lab, sign = tmp_path / "lab.yaml", 1 if frame == "base_link" else -1
    lean = f"[{sign * 0.01}, {sign * 0.02}]  # a set square"
    before = ARM.replace("base_link", frame) + f"work:\n  nail_xy: [{sign * 0.75}, {sign * 0.1}]\n  nail_lean: {lean}\n"
    lab.write_text(before)
    _located(lab, true).write(lab)
    work = load_station(lab).work
    np.testing.assert_allclose(work.X_base_nail(), true.X_base_nail(), atol=3e-5)
    np.testing.assert_allclose(work.wood_rise, true.wood_rise, atol=2e-5)
    assert lab.read_text() == before
    assert work.block_xy == pytest.approx(true.nail_xy, abs=2e-5)
    moved = replace(work, nail_xy=(0.76, 0.105))  # as by a later nail: the plane stays
    assert abs(work.wood_normal @ (moved.p_base_entry - work.p_base_entry)) < 1e-9


@pytest.mark.parametrize(
    ("typed", "words"),
    [
        ("[0.1, 0.75]", "x and y are swapped there"),
        ("[-0.75, -0.1]", "half a turn of the base"),
        ("[0.75, 0.1]", ""),
        ("[0.35, 0.1]", ""),
    ],
)
def test_a_nail_that_was_typed_in_wrongly_is_named_and_a_person_corrects_it_first(
    tmp_path: Path, typed: str, words: str
) -> None:
    lab = tmp_path / "lab.yaml"
    lab.write_text(f"{ARM}work:\n  nail_xy: {typed}\n")
    located = _located(lab, WORK)
    told = mistake(located.entry, located.config.work.p_base_entry)
    assert words in told
    assert bool(told) is bool(words)
    if typed == "[0.75, 0.1]":
        located.write(lab)
        np.testing.assert_allclose(load_station(lab).work.p_base_entry, WORK.p_base_entry, atol=2e-5)
        return
    with raises(ConfigError, "config.measured_place", says=words):
        located.write(lab)
    assert not (tmp_path / "measured.yaml").exists()


def test_of_several_nails_the_one_that_was_located_is_entered_and_the_plane_hangs_between_them(tmp_path: Path) -> None:
    true, lab = replace(WORK, nail_xy=(0.45, 0.40), wood_rise=(0.035, -0.035)), tmp_path / "lab.yaml"
    nails = "[{name: a, xy: [0.46, 0.40]}, {name: b, xy: [0.46, 0.44]}]"
    lab.write_text(f"{ARM}work:\n  block_size: [0.08, 0.14, 0.06]\n  stand_height: 0.21  # a rule\n  nails: {nails}\n")
    _located(lab, true, "a").write(lab)
    work = load_station(lab).work
    np.testing.assert_allclose([nail.xy for nail in work.nails], [[0.45, 0.40], [0.46, 0.44]], atol=2e-5)
    assert work.block_xy == pytest.approx((0.455, 0.42), abs=2e-5), "between the nails"
    np.testing.assert_allclose(work.only("a").p_base_entry, true.p_base_entry, atol=2e-5)
    assert "# a rule" in lab.read_text()


@pytest.mark.parametrize(
    ("work", "reason"),
    [
        ("nail_xy: [0.75, 0.1]\n  nail_lean: [0.1, 0]", "tilt it by"),
        ("nail_xy: [0.68, 0.1]\n  block_xy: [0.66, 0.1]", "outside the block"),
        ("nails: [{name: a, xy: [0.75, 0.12]}, {name: b, xy: [0.75, 0.08], lean: [0.1, 0]}]", "nail b: wood_rise"),
    ],
)
def test_what_the_file_would_not_load_with_is_not_entered(tmp_path: Path, work: str, reason: str) -> None:
    lab = tmp_path / "lab.yaml"
    lab.write_text(before := f"{ARM}work:\n  {work}\n")
    with raises(ConfigError, says=reason) as raised:
        _located(lab, replace(WORK, wood_rise=(-0.12, 0.0))).write(lab)
    assert "nothing was entered" in str(raised.value)
    assert lab.read_text() == before
