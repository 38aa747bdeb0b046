"""The arm's own kinematics from the primary interface, and what follows from them."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.devices.ur.wire import peer_sends, soon
from tests.errors import raises
from tests.examples import examples
from toolee_robot.devices.ur.protocols.tcp import kinematics_from
from toolee_robot.devices.ur.setup_checks import calibration_of, tcp_error, worst_error
from toolee_robot.errors import DeviceError, NoAnswerError, ProtocolError
from toolee_robot.frames import Array
from toolee_robot.robots.urdf import DhParameters
from toolee_robot.types import ArmModel

_six = st.lists(st.floats(-10, 10), min_size=6, max_size=6)
_models = st.sampled_from(list(ArmModel))


def _message(kind: int, content: bytes) -> bytes:
    return struct.pack(">iB", 5 + len(content), kind) + content


def _info(checksum: list[int], dh: DhParameters, more: bytes = b"") -> bytes:
    numbers = np.concatenate([dh.theta, dh.a, dh.d, dh.alpha])
    return _message(5, struct.pack(">6I24dI", *checksum, *numbers, 0) + more)


_CHECKSUM = [0xDEADBEEF + i for i in range(6)]
_GOOD = _message(16, _message(0, bytes(38)) + _info(_CHECKSUM, DhParameters.of(ArmModel.UR10)))


@given(
    theta=_six,
    a=_six,
    d=_six,
    alpha=_six,
    before=st.lists(st.tuples(st.integers(0, 255), st.binary(max_size=60)), max_size=4),
    cut=st.integers(0, 400),
    more=st.binary(max_size=20),
)
def test_the_parameters_come_through(
    theta: list[float],
    a: list[float],
    d: list[float],
    alpha: list[float],
    before: list[tuple[int, bytes]],
    cut: int,
    more: bytes,
) -> None:
    dh = DhParameters(np.array(d), np.array(a), np.array(alpha), np.array(theta))
    other = b"".join(_message(kind, content) for kind, content in before if kind != 16)
    state = _message(16, _message(1, bytes(251)))
    stream = other + state + _message(16, _message(4, bytes(101)) + _info(_CHECKSUM, dh, more))
    with peer_sends(stream[:cut], stream[cut:]) as sock:
        found = kinematics_from(sock, soon())
    assert list(found.checksum) == _CHECKSUM
    for name in ("theta", "a", "d", "alpha"):
        np.testing.assert_array_equal(getattr(found.dh, name), getattr(dh, name))


@given(at=st.integers(0, len(_GOOD) - 1), byte=st.integers(0, 255))
def test_a_damaged_message_is_kinematics_or_a_typed_error(at: int, byte: int) -> None:
    damaged = bytearray(_GOOD)
    damaged[at] = byte
    with peer_sends(bytes(damaged)) as sock:
        try:
            found = kinematics_from(sock, soon())
        except DeviceError:
            return
    assert np.all(np.isfinite(found.dh.fk(np.zeros(6))))


def test_a_controller_that_never_tells_is_given_up() -> None:
    states = tuple(_message(16, _message(1, bytes(251))) for _ in range(100))
    with peer_sends(*states, pause=0.01, close=False) as sock, raises(NoAnswerError, code="no_answer.timeout"):
        kinematics_from(sock, soon(0.2))


def test_parameters_that_are_no_numbers_are_refused() -> None:
    broken = DhParameters(np.full(6, np.nan), np.zeros(6), np.zeros(6), np.zeros(6))
    with peer_sends(_message(16, _info(_CHECKSUM, broken))) as sock, raises(ProtocolError, code="protocol.implausible"):
        kinematics_from(sock, soon())


@examples(20)
@given(model=_models, scale=st.floats(1e-4, 3e-3), seed=st.integers(0, 1000))
def test_the_calibration_of_an_arm_is_the_arm(model: ArmModel, scale: float, seed: int) -> None:
    nominal, rng = DhParameters.of(model), np.random.default_rng(seed)

    def off(values: Array) -> Array:
        return values + scale * rng.uniform(-1, 1, 6)

    own = DhParameters(off(nominal.d), off(nominal.a), off(nominal.alpha), off(nominal.theta))
    assert worst_error(DhParameters.of(model, calibration_of(own, model)), own) < 1e-9
    assert worst_error(nominal, own) > 0.1 * scale


@pytest.mark.parametrize("model", list(ArmModel))
def test_the_models_are_told_apart_by_one_reading(model: ArmModel) -> None:
    other = next(m for m in ArmModel if m is not model)
    rng = np.random.default_rng(1)
    for _ in range(50):
        q = rng.uniform(-np.pi, np.pi, 6)
        tcp = np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.5])
        X = DhParameters.of(model).fk(q)
        pose = np.array([*(X[:3, 3] + 0.1 * X[:3, 2]), *_rotation_vector(X[:3, :3], 0.5)])
        assert tcp_error(DhParameters.of(model), q, tcp, pose) < 1e-6
        assert tcp_error(DhParameters.of(other), q, tcp, pose) > 0.02


def _rotation_vector(R: Array, turn: float) -> Array:
    return (Rotation.from_matrix(R) * Rotation.from_euler("z", turn)).as_rotvec()
