"""`pytest tests/contract --hardware HOST [--hardware-model UR10e]` runs the suite on a robot as well."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.contract.rigs import Rig, hardware_rig, sim_rig, stand_in_rig
from toolee_robot.types import ArmModel


@pytest.fixture(scope="module", params=["pybullet", "UR10", "UR10e", "hardware"])
def shared_rig(request: pytest.FixtureRequest) -> Iterator[Rig]:
    host = request.config.getoption("--hardware")
    if request.param == "pybullet":
        with sim_rig() as rig:
            yield rig
    elif request.param == "UR10":
        with stand_in_rig(ArmModel.UR10, "127.0.0.21") as rig:
            yield rig
    elif request.param == "UR10e":
        with stand_in_rig(ArmModel.UR10E, "127.0.0.22") as rig:
            yield rig
    elif host is None:
        pytest.skip("no robot: give --hardware HOST")
    else:
        with hardware_rig(ArmModel(request.config.getoption("--hardware-model")), host) as rig:
            yield rig


@pytest.fixture
def rig(shared_rig: Rig) -> Iterator[Rig]:
    yield shared_rig
    shared_rig.recover()
