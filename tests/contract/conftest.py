"""On a lab's own devices as well.

`pytest tests/contract --hardware HOST [--hardware-model UR10e]` runs the suite of arms on a robot,
`pytest tests/contract/test_camera_contract.py --camera lab.yaml` that of cameras on the camera of a station file. So do
`test_hand_contract.py --hand lab.yaml` and `test_person_contract.py --person lab.yaml`, which need a person at the
terminal.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.contract.lab import OPTIONS
from tests.contract.rigs import Rig, hardware_rig, sim_rig, stand_in_rig
from toolee_robot.types import ArmModel

_REAL_IN_EVERY_RUN = {
    "test_a_motion_is_driven_as_planned_and_reported_as_sent",
    "test_a_contact_brakes_on_the_path",
    "test_stop_ends_a_motion_on_its_path",
    "test_a_stop_by_the_robot_latches_until_a_person_and_a_reset",
    "test_an_arm_that_does_not_follow_is_stopped_on_its_path",
    "test_lost_data_stops_the_arm_and_old_states_raise",
}
"""What the UR10's driver is asked in every run: how a motion is driven and how it ends. Nightly all is asked."""
_HARDWARE = pytest.param("hardware", marks=pytest.mark.realtime)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "shared_rig" in metafunc.fixturenames:
        seldom = () if metafunc.function.__name__ in _REAL_IN_EVERY_RUN else (pytest.mark.nightly,)
        rigs = [
            pytest.param("pybullet", marks=pytest.mark.sim),
            pytest.param("UR10", marks=(pytest.mark.realtime, *seldom)),
            pytest.param("UR10e", marks=(pytest.mark.realtime, pytest.mark.nightly)),
        ]
        rigs += [_HARDWARE] if metafunc.config.getoption("--hardware") else []
        metafunc.parametrize("shared_rig", rigs, indirect=True, scope="module")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    left_out = {suite for suite, option in OPTIONS.items() if config.getoption(option) is None}
    lab = [item for item in items if item.path.name in left_out and item.name.endswith("[lab]")]
    config.hook.pytest_deselected(items=lab)
    items[:] = [item for item in items if item not in lab]


@pytest.fixture(scope="module")
def shared_rig(request: pytest.FixtureRequest) -> Iterator[Rig]:
    options = request.config.option
    if request.param == "pybullet":
        with sim_rig() as rig:
            yield rig
    elif request.param == "UR10":
        with stand_in_rig(ArmModel.UR10, "127.0.0.21") as rig:
            yield rig
    elif request.param == "UR10e":
        with stand_in_rig(ArmModel.UR10E, "127.0.0.22") as rig:
            yield rig
    else:
        with hardware_rig(ArmModel(options.hardware_model), options.hardware) as rig:
            yield rig


@pytest.fixture
def rig(shared_rig: Rig) -> Iterator[Rig]:
    yield shared_rig
    shared_rig.recover()
