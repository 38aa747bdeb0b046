"""The plane of the wood from touches: found to the touches' accuracy, refused where they tell nothing or disagree."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from tests.errors import raises
from tests.examples import examples
from toolee_robot.app.calibrate_nail import check_near
from toolee_robot.calibration.nail import MIN_WIDTH, fit_wood, locate_nail
from toolee_robot.calibration.touches import add_touch, locate_tip, read_touches
from toolee_robot.cli.app import run
from toolee_robot.control import RobotModel
from toolee_robot.errors import ConfigError, UserError
from toolee_robot.frames import Array, angle_between, inverse, transform
from toolee_robot.station import WorkConfig, load_station, sim_station

WORK = sim_station().work
AT = np.array([0.75, 0.1])
TRIANGLE = np.array([[0.032, 0.0], [-0.016, 0.028], [-0.016, -0.028]])
TIP = np.array([0.004, -0.002, 0.15])
DOWN = Rotation.from_euler("x", 180, degrees=True)
_slope = st.floats(-0.15, 0.15)
ARM = "version: 3\nframe: base_link\narm: {model: UR10, up: [0, 0, 1]}\n"
ACROSS = np.stack([np.cos(np.linspace(0.0, np.pi, 1000)), np.sin(np.linspace(0.0, np.pi, 1000))])
"""Directions in which the width of touched places is measured, (2, 1000)."""


def _on_plane(off: Array, height: float, rise: Sequence[float]) -> Array:
    return np.column_stack([AT + off, height + off @ np.array(rise)])


@examples(50)
@given(
    st.lists(st.tuples(st.floats(-0.04, 0.04), st.floats(-0.04, 0.04)), min_size=3, max_size=6),
    st.floats(0.05, 0.5),
    _slope,
    _slope,
)
def test_touches_without_noise_are_the_plane_or_refused_as_degenerate(
    off: list[tuple[float, float]], height: float, x: float, y: float
) -> None:
    places = np.array(off)
    p = _on_plane(places, height, (x, y))
    if np.min(np.ptp(places @ ACROSS, axis=0)) < MIN_WIDTH:
        with raises(UserError, says="mm further out across the line"):
            fit_wood(p, AT, repeat=2e-4, common=5e-4)
        return
    assume(np.min(np.ptp(places @ ACROSS, axis=0)) > 1.001 * MIN_WIDTH)  # by directions, not edges
    wood = fit_wood(p, AT, repeat=2e-4, common=5e-4)
    np.testing.assert_allclose(wood.point, [*AT, height], atol=1e-9)
    np.testing.assert_allclose(wood.rise, [x, y], atol=1e-9)
    assert angle_between(wood.normal, np.array([-x, -y, 1.0])) < 1e-9
    assert wood.tilt == pytest.approx(np.arctan(np.hypot(x, y)), abs=1e-9)
    assert np.max(np.abs(wood.residuals)) < 1e-9
    assert np.all(np.linalg.eigvalsh(wood.covariance) > 0.0)


@pytest.mark.parametrize("places", [TRIANGLE, np.vstack([TRIANGLE, [[0.03, 0.03], [-0.03, 0.0]]])])
def test_the_covariance_has_the_truth_as_often_as_it_says(places: Array) -> None:
    rng, inside, tilts = np.random.default_rng(0), 0, []
    repeat, common, truth = 2e-4, 5e-4, (0.26, 0.03, -0.05)
    for _ in range(200):
        p = _on_plane(places, truth[0], truth[1:]) + rng.normal(0.0, repeat, (len(places), 3))
        p[:, 2] += rng.normal(0.0, common)
        wood = fit_wood(p, AT, repeat=repeat, common=common)
        off = np.array([wood.point[2], *wood.rise]) - truth
        inside += bool(off @ np.linalg.solve(wood.covariance, off) <= chi2.ppf(0.95, 3))
        tilts.append(angle_between(wood.normal, np.array([-0.03, 0.05, 1.0])))
    assert 0.90 <= inside / 200 <= 0.99
    assert np.median(tilts) < np.deg2rad(0.5)


def test_touches_that_tell_no_plane_are_refused() -> None:
    good = _on_plane(TRIANGLE, 0.26, (0.0, 0.0))
    given_sigmas = {"repeat": 2e-4, "common": 5e-4}
    with raises(UserError, says="a fourth reveals a wrong one"):
        fit_wood(good[:2], AT, **given_sigmas)
    with raises(UserError, says="mm further out across the line") as thin:
        fit_wood(_on_plane(np.array([[-0.03, 0.0], [0.03, 0.0], [0.0, 0.01]]), 0.26, (0, 0)), AT, **given_sigmas)
    assert "up to 60 mm apart, but only 10 mm wide" in str(thin.value)
    assert "20 mm further out" in str(thin.value)
    with raises(UserError, says="mm further out across the line"):
        fit_wood(_on_plane(0.3 * TRIANGLE, 0.26, (0, 0)), AT, **given_sigmas)
    fourth = np.array([[*(AT + 0.02), 0.2615]])
    with raises(UserError, says="the four touches of the wood are not on a plane"):
        fit_wood(np.vstack([good, fourth]), AT, **given_sigmas)
    six = np.vstack([_on_plane(np.vstack([TRIANGLE, -TRIANGLE[:2]]), 0.26, (0, 0)), fourth])
    with raises(UserError, says="touch 6 of the wood is 1.5 mm above") as wrong:
        fit_wood(six, AT, **given_sigmas)
    assert "touch 6 of the wood is 1.5 mm above" in str(wrong.value)


def test_a_list_of_touches_grows_and_another_file_is_not_added_to(tmp_path: Path) -> None:
    file = tmp_path / "wood.yaml"
    q = np.array([0.1, -1.2, 1.3, -1.4, 1.5, 0.0])
    assert [add_touch(file, q), add_touch(file, 2 * q)] == [1, 2]
    np.testing.assert_allclose(read_touches(file).touches, [q, 2 * q])
    (tmp_path / "lab.yaml").write_text("work: {}\n")
    with raises(ConfigError):
        add_touch(tmp_path / "lab.yaml", q)


def _joints(points: Sequence[Array], rng: np.random.Generator) -> list[list[float]]:
    """Joint positions with the tip at each of the points, from different sides."""
    robot, home = RobotModel.of_station(sim_station()), np.array(sim_station().scene.home)
    found = []
    for p in points:
        R = (Rotation.from_rotvec(rng.uniform(-0.3, 0.3, 3)) * DOWN).as_matrix()
        found.append(robot.ik.solve(transform(R, p - R @ TIP), home)[0].tolist())
    return found


def _touched(folder: Path, true: WorkConfig, head: Array) -> list[str]:
    """The options that give touches of the wood and of a nail's head."""
    rng, entry = np.random.default_rng(3), true.p_base_entry
    off = [*TRIANGLE, np.array([0.02, 0.02])]
    wood = [entry + np.array([x, y, np.dot(true.wood_rise, (x, y))]) for x, y in off]
    for name, points in (("wood", wood), ("head", [head] * 3)):
        (folder / f"{name}.yaml").write_text(yaml.safe_dump({"touches": _joints(points, rng)}))
    tip = [f"{1e3 * v:.4f}" for v in TIP]
    return ["--wood", str(folder / "wood.yaml"), "--touches", str(folder / "head.yaml"), "--tip-mm", *tip]


@pytest.mark.parametrize("frame", ["base_link", "pendant_base"])
def test_touches_of_wood_and_head_are_entered_in_the_station_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], frame: str
) -> None:
    true = replace(WORK, nail_xy=(0.752, 0.099), stand_height=0.203, wood_rise=(0.02, -0.03), nail_lean=(0.01, 0.02))
    options, sign = _touched(tmp_path, true, true.X_base_nail()[:3, 3]), 1 if frame == "base_link" else -1
    lab = tmp_path / "lab.yaml"
    lean = f"[{sign * 0.01}, {sign * 0.02}]  # a set square"
    work_text = f"work:\n  nail_xy: [{sign * 0.75}, {sign * 0.1}]\n  nail_lean: {lean}\n"
    lab.write_text(ARM.replace("base_link", frame) + work_text)
    assert run(["calibrate", "nail", *options, "--station", str(lab), "--write", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["tilt_deg"] == pytest.approx(np.rad2deg(np.arctan(np.hypot(0.02, 0.03))), abs=1e-3)
    assert np.sqrt(told["wood_covariance"][0][0]) == pytest.approx(5.1e-4, abs=2e-5), "0.5 mm of the tip"
    work = load_station(lab).work
    np.testing.assert_allclose(work.X_base_nail(), true.X_base_nail(), atol=3e-5)
    np.testing.assert_allclose(work.wood_rise, true.wood_rise, atol=2e-5)
    assert "# a set square" in lab.read_text()
    assert work.block_xy == pytest.approx(true.nail_xy, abs=2e-5)
    moved = replace(work, nail_xy=(0.76, 0.105))  # as by a later nail: the plane stays
    assert abs(work.wood_normal @ (moved.p_base_entry - work.p_base_entry)) < 1e-9


@pytest.mark.parametrize(
    ("typed", "words"),
    [
        ("[0.1, 0.75]", "x and y are swapped there"),
        ("[-0.75, -0.1]", "half a turn of the base"),
        ("[0.75, 0.1]", None),
        ("[0.35, 0.1]", None),
    ],
)
def test_a_nail_that_was_typed_in_wrongly_is_named_where_it_is_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], typed: str, words: str | None
) -> None:
    true, lab = WORK, tmp_path / "lab.yaml"
    options = _touched(tmp_path, true, true.X_base_nail()[:3, 3])
    lab.write_text(f"{ARM}work:\n  nail_xy: {typed}\n")
    command = ["calibrate", "nail", *options, "--station", str(lab)]
    assert run(command) == 0
    said = capsys.readouterr().out
    assert (words is None and "swapped" not in said and "half a turn" not in said) or str(words) in said
    right = typed == "[0.75, 0.1]"
    assert run([*command, "--write"]) == (0 if right else 2), "a person corrects the file first"
    assert words is None or words in " ".join(capsys.readouterr().err.split())
    assert (tmp_path / "measured.yaml").exists() == right
    if right:
        np.testing.assert_allclose(load_station(lab).work.p_base_entry, true.p_base_entry, atol=2e-5)


def test_the_wood_alone_leaves_the_nail_where_it_is_and_counts_from_the_middle_of_the_block(tmp_path: Path) -> None:
    true = replace(WORK, nail_xy=(0.75, 0.1), block_xy=(0.76, 0.11), stand_height=0.203, wood_rise=(0.05, 0.0))
    options = _touched(tmp_path, true, true.X_base_nail()[:3, 3])
    lab = tmp_path / "lab.yaml"
    lab.write_text(f"{ARM}work:\n  nail_xy: [0.75, 0.1]\n  block_xy: [0.76, 0.11]  # a rule\n")
    wood_only = [*options[:2], *options[4:]]
    assert run(["calibrate", "nail", *wood_only, "--station", str(lab), "--write"]) == 0
    work = load_station(lab).work
    assert work.nail_xy == (0.75, 0.1)
    assert "[0.76, 0.11]  # a rule" in lab.read_text()
    assert work.stand_height == pytest.approx(0.203, abs=2e-5)
    np.testing.assert_allclose(work.p_base_entry, true.p_base_entry, atol=2e-5)


def test_wood_that_is_too_steep_and_a_head_at_another_height_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "lab.yaml").write_text(f"{ARM}work: {{nail_xy: [0.75, 0.1]}}\n")
    level = WORK
    options = _touched(tmp_path, level, level.X_base_nail(0.016)[:3, 3])
    assert run(["calibrate", "nail", *options, "--station", str(tmp_path / "lab.yaml")]) == 2
    assert "the nail stands 16.0 mm over the wood" in " ".join(capsys.readouterr().err.split())
    steep = [level.p_base_entry + np.array([x, y, 0.2 * x]) for x, y in TRIANGLE]
    (tmp_path / "wood.yaml").write_text(yaml.safe_dump({"touches": _joints(steep, np.random.default_rng(0))}))
    assert run(["calibrate", "nail", *options[:2], *options[4:], "--station", str(tmp_path / "lab.yaml")]) == 2
    assert "the touches tilt the wood by 11.3°" in " ".join(capsys.readouterr().err.split())


def _refusal(command: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    assert run(["calibrate", "nail", *command]) == 2
    return " ".join(capsys.readouterr().err.split())


def test_the_plane_is_not_carried_to_a_nail_that_nobody_measured_or_that_is_far_away(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    true, lab = replace(WORK, nail_xy=(0.45, 0.40), wood_rise=(0.035, -0.035)), tmp_path / "lab.yaml"
    options = _touched(tmp_path, true, true.X_base_nail()[:3, 3])
    wood_only = [*options[:2], *options[4:], "--station", str(lab)]
    lab.write_text(ARM)
    assert "leaves out work.nail_xy" in _refusal(wood_only, capsys)
    lab.write_text(f"{ARM}work: {{nail_xy: [0.75, 0.1]}}\n")
    assert "outside the circle around the touches of the wood" in _refusal([*wood_only, "--write"], capsys)
    lab.write_text(f"{ARM}work: {{nails: [{{name: a, xy: [0.46, 0.40]}}, {{name: b, xy: [0.46, 0.44]}}]}}\n")
    assert run(["calibrate", "nail", *wood_only, "--write"]) == 0
    work = load_station(lab).work
    assert work.block_xy == (0.46, 0.42), "between the nails"
    assert work.p_base_entry[2] == pytest.approx(0.26 + 0.035 * 0.01, abs=2e-5)


@examples(50)
@given(st.floats(-np.pi, np.pi), st.floats(0.0, 0.2))
def test_a_nail_may_be_50_mm_outside_of_the_touches(direction: float, distance: float) -> None:
    at = AT + distance * np.array([np.cos(direction), np.sin(direction)])
    places = AT + TRIANGLE - TRIANGLE.mean(axis=0)
    radius = float(np.max(np.linalg.norm(places - AT, axis=1)))
    assume(abs(distance - radius - 0.05) > 1e-6)
    if distance < radius + 0.05:
        check_near(places, at)
    else:
        with raises(UserError, says="mm outside the circle around the"):
            check_near(places, at)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (ARM.replace("version: 3\n", ""), "names no version"),
        ("version: 3\nframe: base_link\narm: {model: UR10}\n", "leaves out arm.up"),
        ("version: 3\nframe: base_link\narm: {up: [0, 0, 1]}\n", "leaves out arm.model"),
    ],
)
def test_a_lab_that_does_not_say_which_arm_it_has_and_how_it_stands_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, reason: str
) -> None:
    options, lab = (
        _touched(tmp_path, WORK, WORK.X_base_nail()[:3, 3]),
        tmp_path / "lab.yaml",
    )
    lab.write_text(f"{text}work: {{nail_xy: [0.75, 0.1]}}\n")
    assert reason in _refusal([*options, "--station", str(lab), "--write"], capsys)


@pytest.mark.parametrize(
    ("work", "reason"),
    [
        ("nail_xy: [0.75, 0.1]\n  nail_lean: [0.1, 0]", "tilt it by"),
        ("nail_xy: [0.68, 0.1]\n  block_xy: [0.66, 0.1]", "outside the block"),
        ("nails: [{name: a, xy: [0.75, 0.12]}, {name: b, xy: [0.75, 0.08], lean: [0.1, 0]}]", "nail b: wood_rise"),
    ],
)
def test_what_the_file_would_not_load_with_is_not_entered(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], work: str, reason: str
) -> None:
    true = replace(WORK, wood_rise=(-0.12, 0.0))
    lean = np.array([0.12 + (0.1 if "nail_lean" in work else 0.0), 0.0, 1.0])
    head = true.p_base_entry + true.nail_protrusion * lean / np.linalg.norm(lean)
    options, lab = _touched(tmp_path, true, head), tmp_path / "lab.yaml"
    lab.write_text(before := f"{ARM}work:\n  {work}\n")
    told = _refusal([*options, "--station", str(lab), "--write"], capsys)
    assert "nothing was entered" in told
    assert reason in told
    assert lab.read_text() == before


POINT = np.array([0.6, 0.1, 0.3])


def _touches(rng: np.random.Generator, count: int, tilt: float, noise: float = 0.0) -> list[Array]:
    found = []
    for _ in range(count):
        R = (Rotation.from_rotvec(rng.uniform(-tilt, tilt, 3)) * DOWN).as_matrix()
        found.append(transform(R, POINT + rng.normal(0.0, noise, 3) - R @ TIP))
    return found


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31))
def test_the_tip_is_found_within_its_uncertainty(seed: int) -> None:
    tip = locate_tip(_touches(np.random.default_rng(seed), 10, 0.8, 3e-4))
    off = tip.p_flange_tip - TIP
    assert off @ np.linalg.solve(tip.covariance, off) < 40.0
    assert np.linalg.norm(tip.p_base_point - POINT) < 2e-3
    assert tip.residual < 1.2e-3


def test_touches_that_tell_nothing_are_refused() -> None:
    rng = np.random.default_rng(0)
    with raises(UserError, says="4 touches: give"):
        locate_tip(_touches(rng, 4, 0.8))
    with raises(UserError, says="the touches turn the flange by"):
        locate_tip(_touches(rng, 10, 0.1))
    slipped = _touches(rng, 10, 0.8)
    slipped[6] = transform(p=[0.02, 0.0, 0.0]) @ slipped[6]
    with raises(UserError, says="did the tip leave the point,") as error:
        locate_tip(slipped)
    assert "touch 7" in str(error.value)
    with raises(UserError, says="2 touches: give"):
        locate_nail(_touches(rng, 2, 0.3), TIP)
    with raises(UserError, says="touch the middle of the head"):
        locate_nail(slipped, TIP)


def test_mount_and_nail_from_joint_positions(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot = RobotModel.of_station(sim_station())
    home = np.array(sim_station().scene.home)
    X_base_nail = sim_station().work.X_base_nail()
    rng, joints = np.random.default_rng(1), []
    for _ in range(8):
        R = (Rotation.from_rotvec(rng.uniform(-0.6, 0.6, 3)) * DOWN).as_matrix()
        joints.append(robot.ik.solve(transform(R, X_base_nail[:3, 3] - R @ TIP), home)[0])
        assert np.allclose((inverse(robot.arm.fk(joints[-1])) @ X_base_nail)[:3, 3], TIP, atol=1e-6)
    file = tmp_path / "touches.yaml"
    file.write_text(yaml.safe_dump({"touches": [q.tolist() for q in joints]}))
    lab = "version: 3\nframe: base_link\narm: {model: UR10, up: [0, 0, 1]}\n"
    (tmp_path / "lab.yaml").write_text(lab)
    command = ["calibrate", "mount", "--touches", str(file), "--station", str(tmp_path / "lab.yaml"), "--json"]
    assert run(command) == 0
    found = json.loads(capsys.readouterr().out)
    np.testing.assert_allclose(found["p_flange_tip"], TIP, atol=1e-5)
    tip = [f"{1e3 * v:.4f}" for v in TIP]
    command = ["calibrate", "nail", "--touches", str(file), "--tip-mm", *tip, "--station", str(tmp_path / "lab.yaml")]
    assert run([*command, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    np.testing.assert_allclose(found["head"], X_base_nail[:3, 3], atol=1e-5)
    assert abs(found["height_off"]) < 1e-5
    nails = "  nails:\n    - {name: left, xy: [0.75, 0.145]}\n    - {name: right, xy: [0.75, 0.105]}\n"
    text = f"{lab}work:\n  block_size: [0.08, 0.14, 0.06]\n  stand_height: 0.21  # a rule\n{nails}"
    (tmp_path / "lab.yaml").write_text(text)
    assert run([*command, "--nail", "right", "--write"]) == 0, capsys.readouterr().err
    work = load_station(tmp_path / "lab.yaml").work
    np.testing.assert_allclose([nail.xy for nail in work.nails], [[0.75, 0.145], [0.75, 0.10]], atol=2e-5)
    assert work.stand_height == pytest.approx(0.20, abs=2e-5)
    assert "# a rule" in (tmp_path / "lab.yaml").read_text()
