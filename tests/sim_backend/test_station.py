"""The simulated arm, hand, grip, person and clock keep the promises of the hardware abstraction."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pybullet as pb
import pytest

from tests.errors import raises
from tests.sim_backend.kinematics import HOME, joints_for_hand, line
from toolee_robot.errors import DeviceError, UserError
from toolee_robot.frames import Array, frame_from_axes, inverse, rotation_angle, transform
from toolee_robot.robots import PALM, SHADOW_HAND, load_robot
from toolee_robot.sim_backend import InHandOffset, SimOptions, SimStation
from toolee_robot.sim_backend.devices.operator import handed_over
from toolee_robot.sim_backend.physics.grip import RELEASE_SLIP, GripLimits
from toolee_robot.station import sim_station
from toolee_robot.tools import ToolKind, make_tool, split
from toolee_robot.types import Payload

pytestmark = pytest.mark.sim(seconds=15)

CONFIG = sim_station()
# The palm faces the person, fingers down.
X_BASE_HAND = frame_from_axes(z=np.array([0.0, -0.3, -1.0]), x=np.array([1.0, 0.0, 0.0]), p=[0.55, -0.35, 0.75])
NUDGE = np.array([0.25, -0.15, 0.2, 0.1, -0.2, 0.3])


@pytest.fixture(scope="module")
def q_handover() -> Array:
    return joints_for_hand(X_BASE_HAND)


@pytest.fixture
def empty() -> Iterator[SimStation]:
    with SimStation.build(CONFIG, 0, SimOptions(q_start=HOME, hands_over=False)) as simulation:
        yield simulation


@pytest.fixture(scope="module")
def held(q_handover: Array) -> Iterator[SimStation]:
    """A hammer handed over, closed on, let go: shared by the tests that leave it in the hand."""
    tool = make_tool(ToolKind.BALL_PEEN_HAMMER, 4984)
    with SimStation.build(CONFIG, 3, SimOptions(q_start=q_handover, tool=tool)) as simulation:
        station = simulation.station
        assert station.person.request_handover("", 10.0)
        station.hand.close(8.0)
        assert station.person.release("", 10.0)
        yield simulation


def test_a_tool_against_fingers_that_nobody_moves_presses_on_the_hand(empty: SimStation) -> None:
    """Rigid fingers are one link with what carries them."""
    world = empty.world
    world.tool.place(transform(p=world.robot.link_poses()["rh_mfmiddle"][:3, 3]))
    world.run(0.002)
    forces = empty.station.hand.state().contact_forces
    assert forces[PALM] > 0.0
    assert sum(forces.values()) == forces[PALM]


def test_an_exception_leaves_the_arm_at_rest_and_closed(empty: SimStation) -> None:
    arm = empty.station.arm
    begin = empty.station.clock.now()

    def interrupt(_sample: object) -> None:
        if begin + 0.3 < empty.station.clock.now() < begin + 0.32:
            raise KeyboardInterrupt

    empty.observers.append(interrupt)
    with pytest.raises(KeyboardInterrupt), arm:
        arm.execute(line([HOME, HOME + NUDGE], 1.0))
    assert np.abs(empty.world.robot.arm_state()[1]).max() < 5e-3
    with raises(DeviceError, code="device.closed"):
        arm.state()


def test_time_goes_on_only_by_moving_and_sleeping(empty: SimStation) -> None:
    station = empty.station
    now = station.clock.now()
    station.arm.state()
    station.hand.state()
    assert station.clock.now() == now
    station.clock.sleep(0.123)
    assert station.clock.now() == pytest.approx(now + 0.123, abs=3e-4)


def test_tool_lies_in_the_hand_about_where_the_person_put_it(held: SimStation) -> None:
    X_hand_tool = inverse(held.world.X_base_hand()) @ held.world.X_base_tool()
    X = inverse(held.person.intended_X_hand_tool) @ X_hand_tool
    assert np.linalg.norm(X[:3, 3]) < 0.025
    assert rotation_angle(X[:3, :3]) < np.deg2rad(15)


def test_held_tool_moves_with_the_hand(held: SimStation, q_handover: Array) -> None:
    station, world = held.station, held.world
    before = inverse(world.X_base_hand()) @ world.X_base_tool()
    robot = load_robot()
    hand = robot.hand_payload(station.hand.state().joints.q)
    mass = hand.mass + held.tool.mass
    flange = world.robot.link_pose(world.robot.link_index["tool0"])
    com = (inverse(flange) @ world.X_base_tool() @ [*held.tool.center_of_mass, 1.0])[:3]
    payload = (hand.mass * hand.center_of_mass + held.tool.mass * com) / mass
    station.arm.set_payload(Payload(mass, payload))
    there = station.arm.execute(line([q_handover, q_handover + NUDGE], 1.2))
    station.arm.execute(line([q_handover + NUDGE, q_handover], 1.2))
    after = inverse(world.X_base_hand()) @ world.X_base_tool()
    moved = inverse(before) @ after
    assert np.linalg.norm(moved[:3, 3]) < 0.001
    assert rotation_angle(moved[:3, :3]) < np.deg2rad(0.5)
    assert np.linalg.norm(there.wrenches[5:, :3], axis=1).max() < 8.0


@pytest.mark.nightly
def test_a_grip_pulled_too_hard_slips_and_lets_go(q_handover: Array) -> None:
    tool = make_tool(ToolKind.BALL_PEEN_HAMMER, 4984)
    with SimStation.build(CONFIG, 3, SimOptions(q_start=q_handover, tool=tool, offset=InHandOffset())) as simulation:
        station, world = simulation.station, simulation.world
        station.person.request_handover("", 10.0)
        station.hand.close(8.0)
        station.person.release("", 10.0)
        grip = world.grip
        assert grip is not None
        axis = world.X_base_tool()[:3, 2]

        def pull(force: float, duration: float) -> None:
            def apply(_dt: float) -> None:
                p = pb.getBasePositionAndOrientation(world.tool.body, physicsClientId=world.client)[0]
                pb.applyExternalForce(
                    world.tool.body, -1, (force * axis).tolist(), p, pb.WORLD_FRAME, physicsClientId=world.client
                )

            world.before_step.append(apply)
            station.clock.sleep(duration)
            world.before_step.remove(apply)

        pull(0.6 * grip.limits.along, 0.3)
        assert grip.slip < 0.001
        pull(1.6 * grip.limits.along, 0.02)
        assert 0.0005 < grip.slip < RELEASE_SLIP
        assert station.hand.state().holding
        pull(1.6 * grip.limits.along, 0.3)
        assert not grip.holding
        assert not station.hand.state().holding
        station.clock.sleep(1.0)
        assert world.X_base_tool()[2, 3] < 0.3  # it has fallen


def test_offsets_are_drawn_over_the_whole_range_and_by_seed() -> None:
    drawn = [InHandOffset.draw(np.random.default_rng([seed, 11])) for seed in range(300)]
    assert drawn[7] == InHandOffset.draw(np.random.default_rng([7, 11]))
    for name, reach in (("along", 0.030), ("spin", np.deg2rad(25)), ("tilt_x", np.deg2rad(12))):
        values = np.array([getattr(offset, name) for offset in drawn])
        assert np.abs(values).max() <= reach
        assert values.max() > 0.9 * reach
        assert values.min() < -0.9 * reach


def test_an_offset_moves_the_tool_along_and_about_its_handle() -> None:
    X_nominal = SHADOW_HAND.grasp.X_hand_tool(0.014)
    X = inverse(X_nominal) @ handed_over(X_nominal, InHandOffset(along=0.02, spin=0.3))
    np.testing.assert_allclose(X[:3, 3], [0.0, 0.0, 0.02], atol=1e-12)
    assert rotation_angle(X[:3, :3]) == pytest.approx(0.3)
    np.testing.assert_allclose(X[:3, 2], [0.0, 0.0, 1.0], atol=1e-12)


def test_the_person_brings_only_hammers_that_no_network_has_seen() -> None:
    for seed in range(5):
        with SimStation.build(CONFIG, seed, SimOptions(hands_over=False, q_start=HOME)) as simulation:
            assert split(simulation.tool.seed) == "test"
            assert 0.4 <= simulation.tool.mass <= 1.05


def test_unusable_options_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    with raises(UserError, code="user.no_display"):
        SimStation.build(CONFIG, 0, SimOptions(gui=True))
    with raises(UserError, code="user.friction"):
        SimOptions(friction=0.0)
    with raises(UserError, code="user.seed_negative"):
        SimStation.build(CONFIG, -1)


def test_grip_limits_grow_with_the_fingers_force() -> None:
    weak, strong = (GripLimits.from_contact(n, 0.8, 0.015, 0.075) for n in (40.0, 80.0))
    assert strong.along == pytest.approx(2 * weak.along) == pytest.approx(0.8 * 80)
    assert strong.about == pytest.approx(0.8 * 80 * 0.015)
