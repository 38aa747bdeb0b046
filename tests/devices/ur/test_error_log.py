"""After a protective stop the driver's error names the controller's code: at the stand-in, over its own sockets."""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Iterator
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.devices.ur.swings import swing, wait_for_mid_swing
from tests.errors import raises
from tests.stand_in import PATIENT, held, patient, stand_in
from toolee_robot.devices.ur.driver import UnsupervisedUrArm
from toolee_robot.devices.ur.protocols.tcp import ControllerError, errors_in
from toolee_robot.devices.ur.status import JOINTS, RETRY, ErrorLog, explain
from toolee_robot.errors import LatchedError, ProtectiveStopError
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.sim_backend.ur_controller.robot import error_codes as codes
from toolee_robot.station import sim_station
from toolee_robot.types import ArmModel

HOST = "127.0.0.94"
TWIST = [0.0, 0.0, 0.0, 0.0, 80.0, 0.0]
PROTECTIVE_STOP = 1 << 2  # of RTDE's safety_status_bits
REST = 0.5  # [s] until a stop at rest is known


def error_message(error: ControllerError) -> bytes:
    body = struct.pack(">QbBiiiII", 0, -2, 6, error.code, error.argument, error.level, 0, 0) + error.text.encode()
    return struct.pack(">iB", 5 + len(body), 20) + body


@given(
    errors=st.lists(
        st.builds(
            ControllerError,
            st.integers(0, 500),
            st.integers(0, 20),
            st.integers(0, 133),
            st.text(st.characters(min_codepoint=33, max_codepoint=126), max_size=40),
        ),
        max_size=5,
    ),
    others=st.lists(st.tuples(st.integers(0, 255), st.binary(max_size=60)), max_size=4),
    cuts=st.lists(st.integers(0, 400), max_size=3),
)
def test_errors_come_through_however_the_bytes_are_cut(
    errors: list[ControllerError], others: list[tuple[int, bytes]], cuts: list[int]
) -> None:
    noise = b"".join(struct.pack(">iB", 5 + len(body), kind) + body for kind, body in others if kind != 20)
    stream = noise + b"".join(map(error_message, errors)) + noise
    buffer, found, last = bytearray(), [], 0
    for cut in (*sorted(cuts), len(stream)):
        buffer += stream[last:cut]
        last = max(cut, last)
        found += errors_in(buffer)
    assert found == errors
    assert not buffer


@pytest.mark.parametrize("code", [codes.POSITION_DEVIATES, codes.COLLISION, codes.HIGH_TORQUE, codes.TORQUE_JUMP])
@pytest.mark.parametrize("joint", range(6))
def test_codes_of_a_joint_name_it(code: int, joint: int) -> None:
    clause, kind = explain(ControllerError(code, joint, 3, ""))
    assert f"C{code}A{joint}" in clause
    assert JOINTS[joint] in clause
    assert kind


def test_every_code_of_the_stand_in_has_a_meaning() -> None:
    of_joints = (codes.POSITION_DEVIATES_NO_PAYLOAD, codes.COLLISION_NO_PAYLOAD)
    limits = (
        codes.JOINT_POSITION,
        codes.JOINT_SPEED,
        codes.TCP_SPEED,
        codes.POWER,
        codes.TORQUE_WINDOW,
        codes.MOMENTUM,
    )
    for code, argument in (
        *((code, 0) for code in of_joints),
        *((codes.SAFETY_VIOLATION, limit) for limit in limits),
        (codes.PATH_SANITY, codes.SUDDEN_STOP),
    ):
        assert explain(ControllerError(code, argument, 3, ""))[1]


def test_an_unknown_code_is_named_with_the_controllers_text() -> None:
    clause, kind = explain(ControllerError(403, 0, 3, "Danger of clamping"))
    assert "C403A0" in clause
    assert "Danger of clamping" in clause
    assert kind == ""


@pytest.fixture(scope="module")
def controller() -> Iterator[ControllerProcess]:
    with stand_in(ArmModel.UR10, HOST, profile="harsh") as process:
        yield process


@pytest.fixture
def arm(controller: ControllerProcess) -> Iterator[UnsupervisedUrArm]:
    controller.fault("payload", mass=0.0, cog=[0.0, 0.0, 0.0])
    time.sleep(0.1)
    controller.fault("reset")
    config = patient(HOST)
    lag = 0.2  # of the harsh profile, and of a machine that is busy with other things
    with UnsupervisedUrArm(
        replace(config, servo=replace(config.servo, lag=lag)), replace(sim_station().arm, model=ArmModel.UR10)
    ) as driver:
        yield driver


def wait_for(log: ErrorLog | None, why_empty: str) -> None:
    assert log is not None
    deadline = time.monotonic() + 5.0
    while why_empty not in log.why_empty:
        assert time.monotonic() < deadline, log.why_empty
        time.sleep(0.005)


def listening(log: ErrorLog | None) -> None:
    wait_for(log, "it sent none")


@pytest.mark.realtime
def test_a_stop_in_a_motion_names_code_joint_and_remedy(arm: UnsupervisedUrArm, controller: ControllerProcess) -> None:
    listening(arm._errors)
    trajectory = swing(held(arm))

    def twist() -> None:
        wait_for_mid_swing(arm, trajectory)
        controller.fault("force", wrench=TWIST, seconds=0.3)

    thread = threading.Thread(target=twist)
    thread.start()
    with raises(ProtectiveStopError, code="protective_stop.collision") as caught:
        arm.execute(trajectory, None, PATIENT)
    thread.join()
    reason = str(controller.state()["safety_reason"]).partition(":")[0]
    message = str(caught.value)
    assert reason.startswith("C15")
    assert reason in message
    assert JOINTS[int(reason.partition("A")[2])] in message
    state, report = arm.state(), caught.value.report
    assert state.error_code == reason
    assert state.safety_bits is not None
    assert state.safety_bits & PROTECTIVE_STOP
    assert report is not None
    assert report.safety_bits is not None
    assert not report.safety_bits[0] & PROTECTIVE_STOP
    assert report.safety_bits[-1] & PROTECTIVE_STOP
    assert report.torques is not None
    assert report.currents is None, "the stand-in has none"
    with pytest.raises(LatchedError, match=reason):
        arm.execute(swing(held(arm)), None, PATIENT)


@pytest.mark.nightly
@pytest.mark.realtime
def test_a_stop_at_rest_names_its_code_and_the_next_one_its_own(
    arm: UnsupervisedUrArm, controller: ControllerProcess
) -> None:
    listening(arm._errors)
    controller.fault("payload", mass=50.0, cog=[0.0, 0.0, 0.1])  # no arm holds that
    time.sleep(REST)
    with pytest.raises(LatchedError, match=r"C173A\d: the motion takes more torque than .* check the payload"):
        arm.execute(swing(held(arm)), None, PATIENT)
    controller.fault("payload", mass=0.0, cog=[0.0, 0.0, 0.0])
    time.sleep(0.1)  # the torques jump
    controller.fault("unlock")
    time.sleep(0.1)
    arm.reset()
    controller.fault("protective_stop")  # without a code
    time.sleep(REST)
    with pytest.raises(LatchedError, match="not known: it sent none on port 30001") as caught:
        arm.execute(swing(held(arm)), None, PATIENT)
    assert "C173" not in str(caught.value)


@pytest.mark.nightly
@pytest.mark.realtime
def test_a_closed_port_is_no_obstacle_and_the_message_says_so(
    arm: UnsupervisedUrArm, controller: ControllerProcess
) -> None:
    listening(arm._errors)
    controller.fault("refuse", port="primary")
    controller.fault("drop", port="primary")
    time.sleep(2.0 * RETRY)
    controller.fault("protective_stop")
    time.sleep(REST)
    with pytest.raises(
        LatchedError, match=r"find out why, release it.*not known: no messages come from its port 30001"
    ):
        arm.execute(swing(held(arm)), None, PATIENT)


@pytest.mark.nightly
@pytest.mark.realtime
def test_it_connects_again_after_the_connection_was_lost(arm: UnsupervisedUrArm, controller: ControllerProcess) -> None:
    listening(arm._errors)
    controller.fault("drop", port="primary")
    wait_for(arm._errors, "no messages come")
    listening(arm._errors)
    controller.fault("force", wrench=TWIST, seconds=0.3)
    time.sleep(REST)
    with pytest.raises(LatchedError, match=r"C15[78]A\d"):
        arm.execute(swing(held(arm)), None, PATIENT)
