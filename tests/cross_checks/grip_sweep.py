"""Sweeps in the station's own physics over friction, finger force and wrist compliance: slip, and lost hammers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from tests.cross_checks.held_hammer import GRIP_WIDTH, HeldStrike, Rig
from tests.cross_checks.held_pybullet import held_in_pybullet
from toolee_robot.sim_backend.physics.grip import GripLimits
from toolee_robot.sim_backend.station import draw_hammer
from toolee_robot.tools import Tool

SEEDS = range(7401, 7413)
STRIKES = 4
SPEED = 1.3  # [m/s]
SIDEWAYS = 0.004  # [m] off the face's middle
FINER = 4  # times shorter steps, with which a hammer must be lost, too, if it is lost by force


@dataclass(frozen=True)
class Case:
    """How hammers are held."""

    friction: float = 0.6
    finger_force: float = 60.0
    wrist_torque: float = 3.3


FRICTIONS = (0.2, 0.4, 0.6, 0.9)
FINGER_FORCES = (10.0, 20.0, 40.0, 60.0, 120.0)
WRIST_TORQUES = (0.7, 1.5, 3.3, 7.0, 15.0)


def cases() -> Iterator[Case]:
    """Each parameter alone, the others as they are."""
    yield from (replace(Case(), friction=value) for value in FRICTIONS)
    yield from (replace(Case(), finger_force=value) for value in FINGER_FORCES if value != Case.finger_force)
    yield from (replace(Case(), wrist_torque=value) for value in WRIST_TORQUES if value != Case.wrist_torque)


@dataclass(frozen=True)
class Series:
    """A series of strikes with one hammer, up to its loss."""

    strikes: tuple[HeldStrike, ...]
    lost: bool
    finite: bool


@cache
def hammers() -> tuple[Tool, ...]:
    """The hammers of `SEEDS`."""
    return tuple(draw_hammer(np.random.default_rng([seed, 10])) for seed in SEEDS)


@cache
def series(tool: Tool, case: Case, finer: int = 1) -> Series:
    """Strike with a hammer, `STRIKES` times or until it is lost, with steps as often shorter as `finer` says."""
    limits = GripLimits.from_contact(case.finger_force, case.friction, tool.handle.grip_radius, GRIP_WIDTH)
    rig = Rig.of(tool, limits, case.wrist_torque, SPEED, SIDEWAYS)
    with held_in_pybullet(rig, finer) as held:
        strikes = [held.strike()]
        while held.grip.holding and held.finite and len(strikes) < STRIKES:
            held.swing_again()
            if held.grip.holding and held.finite:
                strikes.append(held.strike())
        return Series(tuple(strikes), not held.grip.holding, held.finite)


def lost_by_arithmetic(tool: Tool, case: Case) -> bool:
    """Whether numbers leave their range, or a hammer is lost that is not with steps as short as `FINER` says."""
    found = series(tool, case)
    return not found.finite or (found.lost and not series(tool, case, FINER).lost)
