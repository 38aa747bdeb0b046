"""Whatever the network or the robot says, the driver answers with a typed error in time, the arm stands, is latched,
and works again when the network does. A proxy before the controller stand-in does the lying (`corrupting_proxy.py`).

With --nightly it draws many corruptions anew instead of a few that stay the same.
"""

from __future__ import annotations

import os
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.devices.ur.corrupting_proxy import CorruptingProxy, Rule
from tests.devices.ur.swings import MOVING, swing, wait_for_mid_swing
from tests.devices.ur.wire import packet
from tests.examples import examples, is_nightly
from tests.stand_in import HOME, held, stand_in
from toolee_robot.devices.ur.config import UrArmConfig
from toolee_robot.devices.ur.driver import UnsupervisedUrArm
from toolee_robot.devices.ur.probe import probe
from toolee_robot.devices.ur.servo.client import ServoClient
from toolee_robot.errors import DeviceError, LatchedError, LinkLostError, MotionFaultError
from toolee_robot.hal import ArmStatus, MotionOutcome, MotionWatch
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.station import ServoConfig, sim_station
from toolee_robot.types import ArmModel

pytestmark = pytest.mark.realtime

ROBOT, HOST = "127.0.0.61", "127.0.0.62"
PATIENCE = 0.32
"""[s] by which data and commands may be late on a busy machine."""
CONFIG = UrArmConfig(HOST, ServoConfig(lag=0.05, watchdog=5.0, hang_timeout=1.0, heartbeat_timeout=1.0))
IN_TIME = 3.0
"""[s] From the first wrong byte to the error."""
BUSY = 4.0
"""[s] Besides, for a machine that is busy with other things: starting a process takes seconds on it."""

NAN, INF = float("nan"), float("inf")
TEXT = packet(b"M", b"\x05hello\x04RTDE\x02")


@pytest.fixture(scope="module")
def model(request: pytest.FixtureRequest) -> ArmModel:
    """The UR10, unless a test asks for both."""
    return ArmModel(getattr(request, "param", ArmModel.UR10))


both = pytest.mark.parametrize(
    "model",
    [ArmModel.UR10, pytest.param(ArmModel.UR10E, marks=pytest.mark.nightly)],
    indirect=True,
    scope="module",
)


@pytest.fixture(scope="module")
def controller(model: ArmModel) -> Iterator[ControllerProcess]:
    with stand_in(model, ROBOT) as process:
        yield process


@pytest.fixture(scope="module")
def proxy(controller: ControllerProcess) -> Iterator[CorruptingProxy]:
    with CorruptingProxy(HOST, controller.host) as evil:
        yield evil


@pytest.fixture(scope="module")
def arm(model: ArmModel, proxy: CorruptingProxy) -> Iterator[UnsupervisedUrArm]:  # noqa: ARG001  (it is on the way)
    with UnsupervisedUrArm(
        replace(CONFIG, servo=replace(CONFIG.servo, connect_timeout=15.0, handshake_timeout=5.0)),
        replace(sim_station().arm, model=model),
    ) as connected:
        yield connected


def poison(variable: str, number: float, every: bool = True) -> Rule:
    return Rule("poison", variable.encode(), number, every=every)


NO_MEASUREMENT = {
    "one reading of joints that are no numbers": poison("actual_q", NAN, every=False),
    "infinite speed": poison("actual_qd", -INF),
    "forces that are no numbers": poison("actual_TCP_force", NAN),
    "no time": poison("timestamp", NAN),
    "time goes back": Rule("shift", b"timestamp", -1000.0, every=True),
}
OTHERS = [
    *(poison(name, number) for name in ("actual_q", "actual_TCP_force") for number in (1e300, -INF)),
    *(poison("timestamp", number, every=False) for number in (NAN, INF, 1e300, -1.0)),
    *(poison(name, number) for name in ("robot_mode", "safety_status_bits") for number in (0, 2**30)),
]


_EVERY_RUN = ("one reading of joints that are no numbers",)
"""Each reading that is no measurement is a fault of the state stream (`servo/test_state_stream.py`); what becomes of it
further on is the same for all, and measured nightly for the others."""


@pytest.mark.parametrize(
    ("model", "rule"),
    [
        *(
            pytest.param(ArmModel.UR10, rule, id=name, marks=() if name in _EVERY_RUN else pytest.mark.nightly)
            for name, rule in NO_MEASUREMENT.items()
        ),
        pytest.param(ArmModel.UR10E, poison("actual_q", NAN, every=False), id="500 Hz", marks=pytest.mark.nightly),
    ],
    indirect=["model"],
    scope="module",
)
def test_what_is_no_measurement_is_a_fault(
    arm: UnsupervisedUrArm, proxy: CorruptingProxy, controller: ControllerProcess, rule: Rule
) -> None:
    error = _swing_while_struck(arm, proxy, controller, rule)
    assert isinstance(error, LinkLostError), f"the motion went on, or ended otherwise: {error!r}"
    assert error.report is not None
    for measured in (error.report.q_measured, error.report.wrenches):
        assert np.abs(measured).max() < 1e3, "garbage is in the report"


@pytest.mark.nightly
@both
def test_ur_rtde_does_not_connect_again_behind_our_back(
    arm: UnsupervisedUrArm, proxy: CorruptingProxy, controller: ControllerProcess
) -> None:
    """Its control interface does, within milliseconds, and the commands between are lost."""
    for skip in (0, 1, 2):  # one connection or another
        error = _swing_while_struck(arm, proxy, controller, Rule("rst", skip=skip))
        assert isinstance(error, MotionFaultError)


# -- drawn at random: what happens to one direction of a connection

_bytes = st.binary(min_size=1, max_size=300)
_size = st.sampled_from([0, 1, 2, 3, 4, 40, 4000, 65535])
_ends = st.sampled_from(["silence", "fin", "rst", "drip"]).map(Rule)
_streams = st.one_of(
    _ends,
    st.sampled_from(OTHERS),
    st.builds(Rule, st.sampled_from(["replace", "insert", "append"]), _bytes),
    st.builds(Rule, st.just("size"), number=_size),
    st.builds(Rule, st.just("kind"), number=st.sampled_from(list(b"\x00VvMUOISP\xff"))),
    st.builds(Rule, st.just("cut"), number=st.integers(1, 60)),
    st.sampled_from(
        [
            Rule("flood", TEXT),
            Rule("flood", packet(b"U", b"\x01")),
            Rule("insert", TEXT, every=True),
            Rule("insert", packet(b"M")),
            Rule("insert", packet(b"M", b"\xff" * 60000)),
            Rule("replace", packet(b"U", b"\x07" + bytes(16)), every=True),
            Rule("replace", packet(b"U", b"\x01" + bytes(59999)), every=True),
            Rule("replace", packet(b"U", b"\x01" + bytes(9))),
        ]
    ),
)
_orders = st.one_of(_ends, st.builds(Rule, st.just("insert"), st.just(bytes(10)))).map(
    lambda rule: replace(rule, to_robot=True)
)
_types = st.sampled_from(["NOT_FOUND", "IN_USE", "DOUBLE", "", "NONSENSE,", "VECTOR6D," * 500, "\xff\xfe"])
_handshakes = st.one_of(
    _streams,
    st.builds(
        lambda kind, number, types: Rule(
            "replace", packet(kind, bytes([number]) + types.encode("latin1")), kind=kind[0]
        ),
        st.sampled_from([b"O", b"I"]),
        st.integers(0, 255),
        _types,
    ),
    st.builds(
        lambda version: Rule("replace", packet(b"v", struct.pack(">4I", *version)), kind=ord("v")),
        st.tuples(*[st.sampled_from([0, 3, 5, 2**32 - 1])] * 4),
    ),
    st.builds(lambda answer: Rule("replace", packet(b"V", answer), kind=ord("V")), st.binary(max_size=3)),
    st.builds(lambda answer: Rule("replace", packet(b"S", answer), kind=ord("S")), st.binary(max_size=3)),
)
_dashboard = st.builds(
    Rule,
    st.sampled_from(["replace", "insert", "append", "silence", "fin", "rst", "drip", "flood"]),
    st.one_of(st.binary(min_size=1, max_size=80), st.sampled_from([b"\n", b"\r\n\x00", b"x" * 100_000])),
    port=st.just(29999),
)


def _few(count: int) -> Callable[[Callable[..., None]], Callable[..., None]]:
    return settings(
        examples(count),
        derandomize=not is_nightly(),
        database=None,
        suppress_health_check=list(HealthCheck),
    )


@both
@_few(3)
@given(rule=st.one_of(_streams, _orders), skip=st.integers(0, 3), moment=st.floats(0.0, 0.3))
def test_any_corruption_in_mid_motion(
    arm: UnsupervisedUrArm, proxy: CorruptingProxy, controller: ControllerProcess, rule: Rule, skip: int, moment: float
) -> None:
    """Some do no harm: the motion is then done as requested, or the fault shows at rest."""
    _swing_while_struck(arm, proxy, controller, replace(rule, skip=skip), moment)


@pytest.mark.nightly
@_few(2)
@given(rule=st.one_of(_handshakes, _dashboard), skip=st.integers(0, 40))
def test_any_corruption_while_connecting(
    arm: UnsupervisedUrArm, proxy: CorruptingProxy, controller: ControllerProcess, rule: Rule, skip: int
) -> None:
    """Of ur_rtde's own connections, which a reset makes anew."""
    os.kill(arm.servo_pid, 9)
    _expect_latch(arm, HOME)
    with suppress(DeviceError):  # what little harm it does
        _within(lambda: ServoClient(CONFIG, 125.0).close(), proxy, replace(rule, skip=skip))
    proxy.heal()
    _ready(arm)
    assert arm.state(1.0).status is ArmStatus.READY
    assert controller.state()["tick"] > 0


@pytest.mark.nightly
@_few(5)
@given(
    rule=st.one_of(_handshakes, _dashboard, st.sampled_from([*NO_MEASUREMENT.values(), *OTHERS])),
    skip=st.integers(0, 12),
)
def test_any_corruption_of_the_questions_before(
    proxy: CorruptingProxy,
    arm: UnsupervisedUrArm,  # noqa: ARG001
    rule: Rule,
    skip: int,
) -> None:
    """`probe` never raises, and is done in time; nor is an arm entered by it that does not say what a robot says."""
    _within(lambda: probe(HOST, timeout=IN_TIME), proxy, replace(rule, skip=skip))
    proxy.heal()


def _within(act: Callable[[], object], proxy: CorruptingProxy, rule: Rule) -> None:
    proxy.arm(rule)
    try:
        act()
    finally:
        struck = proxy.struck()
        assert struck is None or time.monotonic() - struck < IN_TIME + BUSY


def _ready(arm: UnsupervisedUrArm) -> None:
    deadline = time.monotonic() + 30.0
    while True:
        try:
            arm.reset()
            return
        except DeviceError:
            assert time.monotonic() < deadline, "the arm does not come back"
            time.sleep(0.1)


def _expect_latch(arm: UnsupervisedUrArm, q: np.ndarray) -> None:
    with pytest.raises(LatchedError):
        arm.execute(swing(q))


def _swing_while_struck(
    arm: UnsupervisedUrArm, proxy: CorruptingProxy, controller: ControllerProcess, rule: Rule, moment: float = 0.0
) -> Exception | None:
    """The error, or None when the motion was completed; the arm is ready again."""
    cycles = PATIENCE * arm.rate
    patient = MotionWatch(tracking_error=0.5, data_cycles=cycles, overruns=int(cycles))
    _ready(arm)
    trajectory = swing(held(arm))

    def strike() -> None:
        with suppress(DeviceError):
            wait_for_mid_swing(arm, trajectory)
            time.sleep(moment)
        proxy.arm(rule)

    timer = threading.Thread(target=strike)
    timer.start()
    error: Exception | None = None
    try:
        report = arm.execute(trajectory, None, patient)
        assert report.outcome is MotionOutcome.COMPLETED
    except DeviceError as fault:  # anything else fails the test
        error = fault
    ended = time.monotonic()
    timer.join()
    struck = proxy.struck()
    if error is None:
        np.testing.assert_allclose(controller.state()["q"], trajectory.q[-1], atol=1e-3)
    else:
        assert isinstance(error, MotionFaultError)
        assert struck is not None
        assert ended - struck < IN_TIME + BUSY
        _expect_latch(arm, HOME)
        time.sleep(max(0.0, struck + 0.6 - time.monotonic()))
        assert np.abs(controller.state()["qd"]).max() < MOVING, "the arm still moves"
    proxy.heal()
    _ready(arm)
    return error
