"""The examples that the guides are built around run, and do what the guides say."""

from __future__ import annotations

import runpy
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from examples.estimate_poses import print_poses
from examples.new_hammer import drive_nail
from examples.own_camera import OwnCameraStream
from examples.serial_hand import SerialHand
from examples.turn_screw import TurnScrew
from tests.documents.blocks import ROOT, blocks
from tests.documents.hand_device import HandDevice
from tests.perception.data_sets import frames
from tests.robots.three_finger import THREE_FINGER_HAND
from toolee_robot import Category, ToolPerception
from toolee_robot.devices.cameras import StreamedCamera
from toolee_robot.errors import DeviceError, NoAnswerError, StaleDataError
from toolee_robot.frames import Array, angle_between, transform
from toolee_robot.hal import Hand, RgbdCamera
from toolee_robot.perception.io import bop_images
from toolee_robot.robots import hand_model
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend import SimOptions, SimStation
from toolee_robot.station import TaskConfig, sim_station
from toolee_robot.tools import ToolKind, make_tool, test_seeds

WORK = sim_station().work

pytestmark = pytest.mark.sim(seconds=60)


@pytest.fixture(scope="module")
def perception() -> ToolPerception:
    return ToolPerception.load()


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A BOP scene of four images."""
    return frames(tmp_path_factory, "test") / "test" / "000000"


def test_estimate_poses_prints_a_line_for_each_estimate(
    scene: Path, perception: ToolPerception, capsys: pytest.CaptureFixture[str]
) -> None:
    found = {image.im_id: perception.estimate(image.read()) for image in bop_images(scene)}
    im_id, estimates = max(found.items(), key=lambda item: sum(e.usable for e in item[1]))
    frame = next(image.read() for image in bop_images(scene) if image.im_id == im_id)
    usable = print_poses(frame, perception)
    assert usable == sum(e.usable for e in estimates) > 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in lines] == [e.category for e in estimates]


def test_the_lines_of_the_readme_run_as_they_stand(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(ROOT)
    exec(next(text for path, text in blocks("python") if path.name == "README.md"), {})
    assert Category.HAMMER_HEAD in capsys.readouterr().out


@pytest.mark.parametrize("name", [path.stem for path in ROOT.glob("examples/[a-z]*.py") if path.stem != "new_hammer"])
def test_every_example_says_what_it_does(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", [name])
    try:
        said = runpy.run_path(str(ROOT / "examples" / f"{name}.py"), run_name="__main__")["__doc__"]
    except SystemExit as stop:
        said = stop.code
        print(said)
    assert said
    assert capsys.readouterr().out == f"{said}\n"


def test_the_own_camera_is_a_camera_of_the_project() -> None:
    rng, clock = np.random.default_rng(0), HostClock()

    def grab(timeout: float) -> tuple[Any, Any, float] | None:
        clock.sleep(min(timeout, 1 / 30))
        color = rng.integers(90, 110, (480, 640, 3))
        return color, rng.integers(798, 803, (480, 640)), 77.0 + clock.now()

    with StreamedCamera(OwnCameraStream(grab, "0042"), clock) as camera:
        assert isinstance(camera, RgbdCamera)
        frame = camera.read()
        assert camera.profile.serial == "0042"
    assert np.median(frame.depth[100:-100, 100:-100]) == pytest.approx(0.8, abs=0.001)
    assert np.mean(frame.depth > 0) == pytest.approx((525 / 570) ** 2, abs=0.01), "the depth camera sees less"

    def gone(timeout: float) -> None:  # noqa: ARG001
        raise OSError("no such device")

    with pytest.raises(NoAnswerError), StreamedCamera(OwnCameraStream(gone, "0042"), clock):
        pass


class _WallClock:
    def now(self) -> float:
        import time

        return time.monotonic()

    def sleep(self, duration: float) -> None:
        import time

        time.sleep(duration)


@pytest.fixture
def device() -> Iterator[HandDevice]:
    with HandDevice() as device:
        yield device


@pytest.fixture
def hand(device: HandDevice) -> Iterator[SerialHand]:
    with SerialHand(device.port, THREE_FINGER_HAND, _WallClock()) as hand:
        yield hand
        device.silent = False


def test_the_serial_hand_closes_on_a_handle_and_opens_again(device: HandDevice, hand: SerialHand) -> None:
    assert isinstance(hand, Hand)
    device.handle = 1.0
    hand.close()
    state = hand.state()
    assert state.holding
    assert set(state.contact_forces) == {finger.name for finger in THREE_FINGER_HAND.fingers}
    np.testing.assert_allclose(state.joints.q, np.minimum(THREE_FINGER_HAND.posture("closed"), 1.0), atol=2e-3)
    device.handle = None
    hand.open()
    assert not hand.state().holding
    np.testing.assert_allclose(hand.state().joints.q, THREE_FINGER_HAND.posture("open"), atol=2e-3)


def test_the_serial_hand_that_never_arrives_times_out_and_keeps_its_grip(device: HandDevice, hand: SerialHand) -> None:
    device.jammed = True
    with pytest.raises(DeviceError, match="keeps what it holds"):
        hand.close(timeout=0.2)
    assert device.asked[-1] == "hold"


def test_the_serial_hand_that_falls_silent_has_no_state(device: HandDevice, hand: SerialHand) -> None:
    first = hand.state()
    device.silent = True
    assert hand.state(max_age=10.0) is not None
    assert hand.state(max_age=10.0).joints.stamp >= first.joints.stamp
    with pytest.raises(StaleDataError):
        hand.state(max_age=0.05)


def test_the_task_turns_a_screwdriver_about_its_tip_on_the_screw(perception: ToolPerception) -> None:
    config = replace(sim_station(), work=replace(WORK, nail_xy=(0.60, 0.10)))  # nearer to the arm than for strikes
    tool = make_tool(ToolKind.PHILLIPS_SCREWDRIVER, test_seeds(1)[0])
    X_tool_ee = tool.ee(Category.SCREWDRIVER_HEAD).X_tool_ee
    X_hand_ee = hand_model(config.hand.model).grasp.X_hand_tool(tool.handle.grip_radius) @ X_tool_ee
    X_base_screw = transform(p=[0.02, -0.025, 0.0]) @ config.work.X_base_nail(0.0)
    with SimStation.build(config, 0, SimOptions(tool=tool)) as simulation:
        tips: list[Array] = []
        simulation.observers.append(lambda _: tips.append(simulation.world.X_base_tool() @ X_tool_ee))
        TurnScrew(simulation.station, perception, config, X_hand_ee).run(X_base_screw, np.pi / 2)
    tip = np.array(tips)
    on_screw = tip[np.linalg.norm(tip[:, :3, 3] - X_base_screw[:3, 3], axis=1) < 0.005]
    assert len(on_screw) > 50
    assert all(angle_between(X[:3, 2], X_base_screw[:3, 2]) < np.deg2rad(3.0) for X in on_screw)
    x_axes = np.einsum("ji,nj->ni", X_base_screw[:3, :3], on_screw[:, :3, 0])
    turned = np.unwrap(np.arctan2(x_axes[:, 1], x_axes[:, 0]))
    assert turned[-1] - turned[0] == pytest.approx(np.pi / 2, abs=np.deg2rad(2.0))


@pytest.mark.nightly  # a whole job like that of every run, with another tool
def test_a_hammer_known_from_its_data_sheet_drives_a_nail(perception: ToolPerception) -> None:
    config = replace(
        sim_station(), work=replace(WORK, nail_protrusion=0.0015), task=TaskConfig(views=3)
    )  # few strikes, few views
    hammer = make_tool(ToolKind.BALL_PEEN_HAMMER, 9)
    with SimStation.build(config, 0, SimOptions(tool=hammer)) as simulation:
        result = drive_nail(simulation.station, perception, config)
        assert result.success, result.reason
        assert simulation.judge.verdict(result.estimates).worst().outcome == "flush"
