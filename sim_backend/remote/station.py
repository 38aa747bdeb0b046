"""Devices and ground truth of a world in another process, stamped on the controller's clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, Self

from toolee_robot.frames import Array
from toolee_robot.hal import Arm, Clock, HandState, Station
from toolee_robot.robots import load_robot
from toolee_robot.sim_backend.devices.camera import SimCamera
from toolee_robot.sim_backend.physics.nail import Nail
from toolee_robot.sim_backend.truth import StrikeTruth, Verdict
from toolee_robot.sim_backend.visuals import SceneState, SceneVisuals
from toolee_robot.sim_backend.world import SimWorld
from toolee_robot.station import SIMULATED, StationConfig
from toolee_robot.tools import Tool
from toolee_robot.types import InHandEstimate


class HostTimedTruth:
    """A `TruthSource` whose time is the controller's clock at the step, on which all of the station's stamps are.

    The steps of a tick are computed in a burst, so their stamps are closer together than the steps in simulated time.

    Args:
        world: The simulated world.
        clock: The controller's clock.
    """

    def __init__(self, world: SimWorld, clock: Clock) -> None:
        self._world, self._clock = world, clock

    @property
    def client(self) -> int:
        """Id of pybullet's physics client."""
        return self._world.client

    @property
    def time(self) -> float:
        """Time on the controller's clock [s]."""
        return self._clock.now()

    @property
    def nail(self) -> Nail:
        """The nail that the tool is nearest to."""
        return self._world.nail

    @property
    def nails(self) -> Mapping[str, Nail]:
        """The nails by name."""
        return self._world.nails

    @property
    def tool_body(self) -> int:
        """Id of the tool's body in pybullet."""
        return self._world.tool_body

    @property
    def robot_body(self) -> int:
        """Id of the robot's body in pybullet."""
        return self._world.robot_body

    def X_base_hand(self) -> Array:
        """Pose of the palm, 4x4."""
        return self._world.X_base_hand()

    def X_base_ee(self) -> Array:
        """Pose of the tool's end effector, 4x4."""
        return self._world.X_base_ee()


class Caller(Protocol):
    """Sends requests to the world; implemented by `RemoteWorld`."""

    def call(self, name: str, *arguments: Any, lasting: float = 0.0) -> Any:
        """Send a request and wait for its answer.

        Args:
            name: Name of the request.
            *arguments: Its arguments; they must be picklable.
            lasting: Longest duration of the requested action [s].

        Returns:
            The answer.
        """


class RemoteHand:
    """A `hal.Hand`: the simulated hand in the world's process.

    Args:
        world: Sends the requests.
        joint_names: Names of the hand's joints.
    """

    def __init__(self, world: Caller, joint_names: tuple[str, ...]) -> None:
        self._world = world
        self._joint_names = joint_names

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def joint_names(self) -> tuple[str, ...]:
        return self._joint_names

    def state(self, max_age: float = 0.1) -> HandState:
        """See `hal.Hand`."""
        state: HandState = self._world.call("hand.state", max_age)
        return state

    def open(self, timeout: float = 5.0) -> None:
        """See `hal.Hand`."""
        self._world.call("hand.open", timeout, lasting=timeout)

    def close(self, timeout: float = 5.0) -> None:
        """See `hal.Hand`."""
        self._world.call("hand.close", timeout, lasting=timeout)

    def stop(self) -> None:
        """See `hal.Hand`."""
        self._world.call("hand.stop")


class RemotePerson:
    """A `hal.Person`: the simulated person in the world's process.

    Args:
        world: Sends the requests.
    """

    def __init__(self, world: Caller) -> None:
        self._world = world

    def request_handover(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`."""
        return bool(self._world.call("person.request_handover", prompt, timeout, lasting=timeout))

    def release(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`."""
        return bool(self._world.call("person.release", prompt, timeout, lasting=timeout))

    def take_tool(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`."""
        return bool(self._world.call("person.take_tool", prompt, timeout, lasting=timeout))

    def confirm_swing(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`."""
        return bool(self._world.call("person.confirm_swing", prompt, timeout, lasting=timeout))

    def confirm_inspection(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`."""
        return bool(self._world.call("person.confirm_inspection", prompt, timeout, lasting=timeout))

    def hold_switch(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`."""
        return bool(self._world.call("person.hold_switch", prompt, timeout, lasting=timeout))

    def zone_occupied(self) -> bool:
        """See `hal.Person`."""
        return bool(self._world.call("person.zone_occupied"))

    def readings_certain(self) -> bool:
        """See `hal.Person`."""
        return True

    def hold_to_run_held(self) -> bool:
        """See `hal.Person`."""
        return bool(self._world.call("person.hold_to_run_held"))


class RemoteJudge:
    """A `Truth`: the judge in the world's process. Its stamps are on the world's clock.

    Args:
        world: Sends the requests.
    """

    def __init__(self, world: Caller) -> None:
        self._world = world

    @property
    def strikes(self) -> tuple[StrikeTruth, ...]:
        strikes: tuple[StrikeTruth, ...] = self._world.call("judge.strikes")
        return strikes

    def X_hand_ee(self, stamp: float) -> Array:
        X: Array = self._world.call("judge.X_hand_ee", stamp)
        return X

    def verdict(self, estimates: Sequence[tuple[float, InHandEstimate]] = ()) -> Verdict:
        verdict: Verdict = self._world.call("judge.verdict", list(estimates))
        return verdict


def remote_station(world: Caller, config: StationConfig, seed: int, tool: Tool, arm: Arm, clock: Clock) -> Station:
    """Build a station on a remote world; the camera renders in this process, so that it does not delay the ticks.

    Args:
        world: Sends the requests.
        config: The station.
        seed: Seed of the run.
        tool: The tool that is handed over.
        arm: The arm.
        clock: The clock of the world and the arm.

    Returns:
        The station.
    """

    def state() -> SceneState:
        now: SceneState = world.call("scene")
        return now

    hand = RemoteHand(world, load_robot(config.arm.model, config.arm.calibration, config.hand).hand_joints)
    camera = SimCamera(SceneVisuals(config, tool, seed, state), clock, config.camera.uncalibrated, seed)
    return Station(arm, hand, camera, RemotePerson(world), clock, SIMULATED, SIMULATED)
