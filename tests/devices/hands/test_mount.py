"""The driver of a tool mount: it says what a person said last, and claims nothing else."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from toolee_robot.devices.hands.mount import MountedTool
from toolee_robot.hal import Hand
from toolee_robot.robots import hand_model
from toolee_robot.runtime.clock import HostClock
from toolee_robot.station import load_station


def test_a_mount_holds_what_a_person_fixed_in_it() -> None:
    config = load_station(Path(__file__).parents[3] / "examples" / "mount.yaml")
    with MountedTool(hand_model(config.hand), HostClock()) as mount:
        assert isinstance(mount, Hand)
        assert mount.joint_names == ("mount_hinge",)
        assert not mount.state().holding
        mount.close()
        mount.stop()
        state = mount.state()
        assert state.holding
        assert state.contact_forces == {}
        assert state.temperature is None
        np.testing.assert_array_equal(state.joints.q, [0.0])
        mount.open()
        assert not mount.state().holding
