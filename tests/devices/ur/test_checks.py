"""Whatever a controller says of itself, the checks answer in findings; nonsense is never well."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tests.examples import examples
from toolee_robot.devices.ur.checks import UrExpected, check
from toolee_robot.devices.ur.probe import PortState, RtdeQuality, UrReport, UrState
from toolee_robot.devices.ur.protocols.tcp import UrKinematics
from toolee_robot.findings import Level, worst
from toolee_robot.frames import Array
from toolee_robot.robots.urdf import DhParameters
from toolee_robot.types import ArmModel, Payload

_any = st.floats() | st.floats(-10, 10)
_bits = st.integers(0, 2**32 - 1)
_mode = st.integers(-3, 20)
_models = st.sampled_from(list(ArmModel))


def _vector(n: int) -> st.SearchStrategy[Array]:
    return st.lists(_any, min_size=n, max_size=n).map(np.array)


_payload = st.builds(Payload, _any, _vector(3))
_state = st.builds(
    UrState,
    q=_vector(6),
    qd=_vector(6),
    tcp_pose=_vector(6),
    tcp_offset=st.none() | _vector(6),
    payload=st.none() | _payload,
    robot_mode=_mode,
    safety_mode=_mode,
    runtime_state=_mode,
    robot_status_bits=_bits,
    safety_status_bits=_bits,
    speed_slider=_any,
)
_quality = st.builds(
    RtdeQuality,
    asked=st.sampled_from([125.0, 500.0]),
    rate=_any,
    samples=st.integers(10, 600),
    lost=st.integers(0, 2**31),
    backward=st.integers(0, 600),
    gap_p99=_any,
    gap_max=_any,
    clock_ratio=_any,
)
_parameters = st.builds(DhParameters, *[st.lists(st.floats(-1e4, 1e4), min_size=6, max_size=6).map(np.array)] * 4)
_text = st.none() | st.text(min_size=1, max_size=30)
_report = st.builds(
    UrReport,
    host=st.just("192.168.1.10"),
    ports=st.dictionaries(
        st.sampled_from([29999, 30001, 30004]),
        st.builds(PortState, st.none() | st.floats(0, 10), st.text(max_size=20)),
        min_size=1,
    ),
    version=st.none() | st.tuples(*[st.integers(0, 30)] * 4),
    model=_text,
    serial=_text,
    remote_control=st.none() | st.booleans(),
    state=st.none() | _state,
    quality=st.none() | _quality,
    kinematics=st.none() | st.builds(UrKinematics, st.just((0,) * 6), _parameters),
    problems=st.lists(st.text(max_size=20).map("RTDE: {}".format), max_size=2).map(tuple),
)


@examples(100)
@given(report=_report, model=_models, payload=st.none() | st.just(Payload(5.0)), serial=_text)
def test_any_report_is_answered_in_findings(
    report: UrReport, model: ArmModel, payload: Payload | None, serial: str | None
) -> None:
    with np.errstate(all="ignore"):
        findings = check(report, UrExpected(model, payload=payload, tcp=np.zeros(6), serial=serial))
    assert findings
    assert len({f.name for f in findings}) == len(findings)
    assert all(f.message and bool(f.remedy) == (f.level is not Level.OK) for f in findings)
    state = report.state
    nonsense = state is None or not all(np.all(np.isfinite(v)) for v in (state.q, state.qd, state.tcp_pose))
    if nonsense or not report.reachable:
        assert worst(findings) is Level.FAIL
