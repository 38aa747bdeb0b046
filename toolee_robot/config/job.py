"""How a job strikes, when it looks again and ends, and what the supervisor lets pass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.config.values import STRICT, Count, NotNegative, Positive


@dataclass(frozen=True)
class StrikeConfig:
    """How to hit."""

    __pydantic_config__ = STRICT
    speed: Positive = 1.2
    """Wanted speed of the face at contact [m/s]. From 1.2 the hand needs some 90 mm to stop, from 1.5 140 mm, which it
    does not have beside the block with a short hammer."""
    run_up: Positive = 0.20
    """Length of the straight run to the nail [m]."""
    touch_speed: Positive = 0.03
    """Speed of the touch, which measures where the face meets the nail [m/s]."""
    touch_force: Positive = 8.0
    """Sensed force that ends a touch [N]; less than what a yielding wrist passes on at a long hammer's end."""
    contact_force: Positive = 15.0
    """Sensed force that counts as the strike's contact [N]."""
    clearance: NotNegative = 0.008
    """Least distance of anything to anything but face and nail [m]."""


@dataclass(frozen=True)
class TaskConfig:
    """When to go on, to look again and to end."""

    __pydantic_config__ = STRICT
    max_strikes: Count = 40
    """Most strikes of a job."""
    flush_protrusion: Positive = 0.001
    """Protrusion up to which the nail counts as flush [m]."""
    min_progress: NotNegative = 0.0002
    """A strike that drives the nail by less has not moved it [m]."""
    slip_per_strike: NotNegative = 0.0015
    """Standard deviation of the tool's drift in the hand with a strike [m]."""
    slip_angle_per_strike: NotNegative = np.pi / 450
    """Standard deviation of the tool's turn in the hand with a strike [rad]."""
    abort_slip: Positive = 0.015
    """Slip between two looks from which on the tool must be gripped again [m]."""
    abort_slip_angle: Positive = np.pi / 12
    """Turn between two looks from which on the tool must be gripped again [rad]."""
    views: Count = 6
    """Views of the first look."""
    views_again: Count = 4
    """Views of later looks."""
    strikes_between_looks: Count = 4
    """Strikes after which the task looks again."""
    handover_timeout: Positive = 30.0
    """How long each question to the person waits for an answer [s]."""


@dataclass(frozen=True)
class SupervisorConfig:
    """What the supervisor lets pass, on top of the joints' limits."""

    __pydantic_config__ = STRICT
    handover_speed: Positive = 0.25
    """Most that flange and tool may move with while a person is in reach [m/s]: the reduced speed of ISO 10218-1."""
    unattended_speed: Positive = 1.5
    """Most that flange and tool may move with while nobody is in reach [m/s]."""
    tracking_error: Positive = 0.05
    """Most that a joint may be away from its command in a motion, the servo's known lag taken off [rad]."""
    data_cycles: Positive = 3.0
    """Most cycles for which the arm's newest reading may be old in a motion."""
    overruns: Count = 3
    """Most command cycles in a row that may be late in a motion."""
    max_data_age: Positive = 0.1
    """Oldest reading of the arm that a motion may begin with [s]."""
    early_contact: Positive = 0.024
    """How far before the expected place a strike may meet the nail [m]; at 1.2 m/s and 125 Hz the force is felt some 15
    mm behind where it began."""
    late_contact: Positive = 0.030
    """How far beyond the expected place a strike may meet the nail [m]."""
    max_hand_temperature: Positive = 65.0
    """A hotter hand gets no further strike [deg C]."""
    ask_before_swing: bool = True
    """Whether a person must confirm the first strike of a job."""
