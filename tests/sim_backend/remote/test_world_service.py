"""The world behind a controller's tick loop: devices that wait, truth on the host's clock, and nobody else's steps."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from multiprocessing import Pipe
from typing import Any

import numpy as np
import pytest

from tests.errors import raises
from tests.examples import seldom
from tests.sim_backend.kinematics import joints_for_hand
from toolee_robot.errors import DeviceError, TooleeError
from toolee_robot.frames import Array, frame_from_axes, inverse
from toolee_robot.runtime.clock import HostClock, readable
from toolee_robot.sim_backend import SimOptions, SimStation
from toolee_robot.sim_backend.devices.camera import SimCamera
from toolee_robot.sim_backend.remote import Channel, RemoteJudge
from toolee_robot.sim_backend.station import build_world, draw_handover
from toolee_robot.sim_backend.ur_controller.robot.plant import Plant
from toolee_robot.sim_backend.ur_controller.server.port import Service
from toolee_robot.sim_backend.visuals import SceneVisuals
from toolee_robot.sim_backend.world_plant import WorldPlant, WorldService
from toolee_robot.station import sim_station

pytestmark = pytest.mark.sim

CONFIG, SEED, TICK = sim_station(), 101, 0.008
PERIOD = 0.005  # [s] between ticks: faster than real, and time for the other thread
SLOW = HostClock(
    real_time_factor=0.2
)  # the world's time, at least: a tick with a hand full of contacts takes 11 ms, on two busy
# cores several times as long
# The palm faces the person, fingers down.
X_BASE_HAND = frame_from_axes(z=np.array([0.0, -0.3, -1.0]), x=np.array([1.0, 0.0, 0.0]), p=[0.55, -0.35, 0.75])
OPTIONS = SimOptions(q_start=joints_for_hand(X_BASE_HAND))


class Loop(threading.Thread):
    """The least controller: requests between ticks. hold: no ticks while it is set."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        ours, self._theirs = Pipe()
        self.ended, self.hold, self.ready = threading.Event(), threading.Event(), threading.Event()
        self.ticks = 0
        self.start()
        self.ready.wait(30.0)
        self.channel = Channel(ours)

    def call(self, name: str, *arguments: Any, lasting: float = 0.0) -> Any:
        """As `RemoteWorld.call`: lasting is the world's time, which here goes on as fast as it is computed."""
        return self.channel.call(name, *arguments, lasting=SLOW.to_wall_time(lasting))

    def run(self) -> None:
        service = WorldService(self._theirs, CONFIG, SEED, OPTIONS, HostClock())
        service.ended = self.ended.set
        plant = WorldPlant(service.world, TICK)
        payload = service.world.robot.robot.hand_payload(service.world.robot.q_hand_target)
        plant.set_payload(payload.mass, payload.center_of_mass)
        part: Service = service
        self.plant: Plant = plant
        self.world = service.world
        self.ready.set()
        while not self.ended.is_set():
            due = time.monotonic() + PERIOD  # no tick is caught up: that would be the other thread's time
            for fd in readable(part.filenos(), due - time.monotonic()):
                part.on_readable(fd)
            if not self.hold.is_set():
                plant.step(TICK)
                part.on_tick(TICK)
                self.ticks += 1
        part.close()


@pytest.fixture
def loop() -> Iterator[Loop]:
    loop = Loop()
    yield loop
    loop.channel.close()
    loop.join(10.0)
    assert loop.ended.is_set(), "the loop ends when its client hangs up"


@pytest.mark.nightly
def test_a_handover_through_the_pipe_is_the_direct_one(loop: Loop) -> None:
    """The same seed, tool, offset and room; the same hold; frames and truth on the host's clock."""
    tool, _ = draw_handover(SEED, OPTIONS)
    loop.hold.set()  # two worlds would take turns on one core
    with SimStation.build(CONFIG, SEED, OPTIONS) as direct:
        assert direct.tool.name == tool.name
        expected = direct.station.camera.read()
        direct.station.hand.open()
        assert direct.station.person.request_handover("", 5.0)
        direct.station.hand.close()
        assert direct.station.person.release("", 5.0)
        X_direct = direct.judge.X_hand_ee(direct.station.clock.now())
    loop.hold.clear()
    visuals = SceneVisuals(CONFIG, tool, SEED, lambda: loop.call("scene"))
    began = time.monotonic()
    frame = SimCamera(visuals, HostClock(), CONFIG.camera.uncalibrated, SEED).read()
    np.testing.assert_allclose(frame.rgb.astype(float).mean(), expected.rgb.astype(float).mean(), atol=2.0)
    assert np.mean(np.abs(frame.rgb.astype(float) - expected.rgb)) < 5.0
    loop.call("hand.open", 5.0, lasting=5.0)
    assert loop.call("person.request_handover", "", 5.0, lasting=5.0)
    loop.call("hand.close", 5.0, lasting=5.0)
    assert loop.call("person.release", "", 5.0, lasting=5.0)
    assert began < frame.stamp <= time.monotonic()
    judge = RemoteJudge(loop)
    X = judge.X_hand_ee(time.monotonic() - 0.1)  # the clock on the wall may be ahead of a world that is late
    assert np.linalg.norm(X[:3, 3] - X_direct[:3, 3]) < 0.004
    assert judge.verdict().hits == 0
    assert judge.strikes == ()
    with raises(TooleeError, code="toolee.outside_of_run"):
        judge.X_hand_ee(began - 1e3)


@pytest.mark.nightly
def test_the_hand_closes_while_the_arm_moves_and_is_seen(loop: Loop) -> None:
    q_start = loop.plant.q.copy()
    closing = _closing(loop)
    time.sleep(0.05)
    with raises(DeviceError, code="device.busy"):
        loop.call("hand.open", 5.0, lasting=5.0)
    fingers = []
    target = q_start.copy()
    while closing.is_alive():
        target[0] += 0.002
        loop.plant.command(target, np.zeros(6))
        fingers.append(_fingers(loop))
    closing.join()
    assert len(fingers) > 20
    assert np.ptp(np.array(fingers), axis=0).max() > 0.02, "the fingers closed"
    assert loop.plant.q[0] > q_start[0] + 0.01


def test_time_alone_ends_a_wait(loop: Loop) -> None:
    assert not loop.call("person.request_handover", "", 0.2, lasting=0.2), "a person needs longer than that"


@pytest.mark.nightly
def test_nothing_but_the_tick_loop_steps_the_world(loop: Loop) -> None:
    """While no tick is done, a hand's command does not end, the scene can be seen, and no time passes."""
    loop.hold.set()
    _fingers(loop)  # answered between two ticks: none is under way any more
    ticks, before = loop.ticks, loop.world.time
    closing = _closing(loop)
    still = [_fingers(loop) for _ in range(5)]
    assert closing.is_alive()
    assert (loop.ticks, loop.world.time) == (ticks, before)
    np.testing.assert_array_equal(still[0], still[-1])
    loop.hold.clear()
    closing.join(20.0)
    assert not closing.is_alive()
    with pytest.raises(RuntimeError, match="nothing else may wait"):
        loop.world.wait(0.1)


def _closing(loop: Loop) -> threading.Thread:
    thread = threading.Thread(target=lambda: loop.call("hand.close", 5.0, lasting=5.0))
    thread.start()
    return thread


def _fingers(loop: Loop) -> Array:
    """Places of the links of the hand in the palm's axes, (N, 3) [m]."""
    links = loop.call("scene").links
    X_palm_base = inverse(links["rh_palm"])
    return np.array([(X_palm_base @ X)[:3, 3] for name, X in links.items() if name.startswith("rh_")])


def test_unknown_requests_and_failures_are_answers_and_an_ended_world_says_so(loop: Loop) -> None:
    with raises(DeviceError, code="device.unknown_request"):
        loop.channel.call("hand.__class__")
    with raises(DeviceError, code="device.world_failed"):
        loop.channel.call("judge.X_hand_ee")
    assert "tool0" in loop.channel.call("scene").links
    loop.channel.close()
    loop.join(10.0)
    with raises(DeviceError, code="device.world_ended"):
        loop.channel.call("scene")


def test_a_push_is_felt_at_the_flange_in_the_controllers_base(loop: Loop) -> None:
    def felt(push: list[float]) -> Array:
        loop.plant.external_force = np.array(push)
        ticks = loop.ticks
        while loop.ticks < ticks + 40:
            time.sleep(0.01)
        return loop.plant.wrench.copy()

    rest = felt([0.0] * 6)
    assert np.abs(rest).max() < 2.0
    for push in ([30.0, 20.0, 10.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0, -2.0, 3.0]):
        np.testing.assert_allclose(felt(push) - rest, push, atol=0.1)
    # What the motors cannot bear, the arm gives way to: a push along the controller's x is one along -x of base_link.
    before = loop.world.X_base_hand()[:3, 3]
    felt([800.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert loop.world.X_base_hand()[0, 3] < before[0] - 0.005


TURN = np.array([0.3, 0.2, -0.2, 0.3, 0.2, 0.4])  # [rad] in a second


@pytest.mark.parametrize("period", seldom(0.008, 0.002), ids=["CB3", "e-Series"])
def test_elastic_joints_follow_a_controllers_ticks_and_come_to_rest(period: float) -> None:
    options = SimOptions(compliance=1.0, hands_over=False)
    world = build_world(sim_station(), draw_handover(1, options)[0], options)
    try:
        plant = WorldPlant(world, period)
        hand = world.robot.robot.hand_payload(world.robot.robot.hand_open)
        plant.set_payload(hand.mass, hand.center_of_mass)
        start = plant.q.copy()
        for k in range(round(1.7 / period)):
            q = start + 0.5 * (1.0 - np.cos(np.pi * min((k + 1) * period, 1.0))) * TURN
            plant.command(q, np.zeros(6))
            plant.step(period)
            np.testing.assert_allclose(plant.q, q, atol=1e-3)
        np.testing.assert_allclose(plant.q, start + TURN, atol=1e-6)
        assert np.abs(plant.qd).max() < 1e-3
        # 1 kg that it is not told of: the joints sag.
        plant.set_payload(hand.mass - 1.0, hand.center_of_mass)
        for _ in range(round(1.0 / period)):
            plant.command(q, np.zeros(6))
            plant.step(period)
        assert 1e-5 < np.abs(plant.q - q).max() < 5e-4
    finally:
        world.close()
