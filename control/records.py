"""What the planners hand to the tasks."""

from __future__ import annotations

from dataclasses import dataclass

from toolee_robot.control.collision import Clearance
from toolee_robot.control.contact import ExpectedContact
from toolee_robot.frames import Array
from toolee_robot.types import Trajectory


@dataclass(frozen=True)
class StrikePlan:
    """One strike.

    theta: the chosen spin of the hammer about the nail's axis [rad]. q_standoff, q_contact: (6,) [rad], at rest before
    the run-up, and where face and nail are expected to meet. approach: transfer from where the arm is to q_standoff.
    strike: from rest at q_standoff through the contact to the standstill; at `contact_time` [s] on it the face arrives
    with `speed` [m/s] and braking begins; it ends brake_length [m] further down. wanted_speed: what was asked for;
    attainable_speed: what the joints' velocities alone would allow there. clearance: of the strike; margin: least
    distance to a joint's limit [rad].
    X_base_ee_contact: 4x4, equals the nail's pose up to the spin.
    """

    theta: float
    q_standoff: Array
    q_contact: Array
    approach: Trajectory
    strike: Trajectory
    contact_time: float
    speed: float
    wanted_speed: float
    attainable_speed: float
    run_up: float
    brake_length: float
    clearance: Clearance
    margin: float
    X_base_ee_contact: Array
    planning_time: float

    @property
    def expected_contact(self) -> ExpectedContact:
        """Where face and nail should meet."""
        return ExpectedContact(self.q_contact, self.X_base_ee_contact[:3, 2], self.contact_time)


@dataclass(frozen=True)
class View:
    """One configuration in which the camera sees the tool.

    q: (6,) [rad]. transfer: from the view before (or the start). Nominal, from the geometry the plan assumed:
    distance of the face's centre from the camera [m], angle between the face's normal and the line of sight [rad].
    """

    q: Array
    transfer: Trajectory
    distance: float
    normal_angle: float


@dataclass(frozen=True)
class ViewPlan:
    """Views in the order in which to visit them."""

    views: tuple[View, ...]
    clearance: float
