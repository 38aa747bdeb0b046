"""Records that the planners return to the tasks."""

from __future__ import annotations

from dataclasses import dataclass

from toolee_robot.control.collision import Clearance
from toolee_robot.control.contact import ExpectedContact
from toolee_robot.frames import Array
from toolee_robot.types import Trajectory


@dataclass(frozen=True)
class StrikePlan:
    """Plan of one strike.

    Attributes:
        theta: Chosen spin of the hammer about the nail's axis [rad].
        q_standoff: Joint positions at rest before the run-up, (6,) [rad].
        q_contact: Joint positions at the expected contact of face and nail, (6,) [rad].
        approach: Transfer from the arm's present position to `q_standoff`.
        strike: Motion from rest at `q_standoff` through the contact to standstill.
        contact_time: Time of the expected contact on `strike` [s].
        speed: Planned speed of the face at the contact [m/s].
        wanted_speed: Requested speed of the face at the contact [m/s].
        attainable_speed: Speed that the joints' velocity limits alone would allow at the contact [m/s].
        run_up: Height of the face over the contact at the start of the strike [m].
        brake_length: Largest distance of the commanded face beyond the contact [m].
        clearance: Closest pair of bodies during the strike.
        margin: Least distance to a joint's position limit [rad].
        X_base_ee_contact: Pose of the end effector at the contact in `base`, (4, 4); equals the nail's pose up to the
            spin.
        planning_time: Wall-clock time of the planning [s].
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
        X = self.X_base_ee_contact
        return ExpectedContact(self.q_contact, X[:3, 3], X[:3, 2], self.contact_time)


@dataclass(frozen=True)
class View:
    """One configuration in which the camera sees the tool.

    Attributes:
        q: Joint positions, (6,) [rad].
        transfer: Motion from the previous view, or from the start.
        distance: Nominal distance of the face's centre from the camera [m].
        normal_angle: Nominal angle between the face's normal and the line of sight [rad].
    """

    q: Array
    transfer: Trajectory
    distance: float
    normal_angle: float


@dataclass(frozen=True)
class ViewPlan:
    """Plan of a look.

    Attributes:
        views: The views in the order of their visit.
        clearance: Least clearance of the views' configurations [m].
    """

    views: tuple[View, ...]
    clearance: float
