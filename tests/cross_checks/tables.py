"""The cross-checks' cases, and their tables in Markdown."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tests.cross_checks.free_head import in_mujoco, in_pybullet, wire_mass
from tests.cross_checks.friction_grasp import held_by_friction
from tests.cross_checks.grip_sweep import cases, hammers, lost_by_arithmetic, series
from tests.cross_checks.held_hammer import GRIP_WIDTH, HeldStrike, Rig
from tests.cross_checks.held_mujoco import held_in_mujoco
from tests.cross_checks.held_pybullet import held_in_pybullet
from tests.sim_backend.physics.energy_balance import driven_by
from toolee_robot.sim_backend.physics.grip import GripLimits
from toolee_robot.sim_backend.physics.wood import NailSpec
from toolee_robot.station import sim_station

SPEC = NailSpec.from_config(sim_station().work)
THICK = NailSpec(0.0031, 0.065, 0.007, 0.001, 0.045, 0.42, 0.0)
"""A nail of 3.1 x 65 mm in pine, without a hole."""
MASSES, SPEEDS = (0.3, 0.6, 1.2), (0.6, 1.0, 1.5, 2.0)


def free_head_table() -> Iterator[str]:
    """Rows of the table of free heads on a nail."""
    yield "| nail | head | speed | here | MuJoCo | difference | MuJoCo, a nail of its own mass | energy balance |"
    yield "|---|---|---|---|---|---|---|---|"
    for name, spec in (("2.2 x 30", SPEC), ("3.1 x 65", THICK)):
        for mass in MASSES:
            for speed in SPEEDS:
                ours = 1e3 * in_pybullet(spec, mass, speed)
                lumped = 1e3 * in_mujoco(spec, mass, speed)
                wire = 1e3 * in_mujoco(spec, mass, speed, nail=wire_mass(spec))
                balance = 1e3 * driven_by(spec, spec.protrusion, 0.5 * mass * speed**2)
                yield (
                    f"| {name} | {mass} kg | {speed} m/s | {ours:.2f} mm | {lumped:.2f} mm | {ours - lumped:+.2f} mm, "
                    f"{100 * (ours / lumped - 1):+.0f} % | {wire:.2f} mm | {balance:.2f} mm |"
                )


BAD_HITS = ((0.0, 0.0), (0.004, 0.0), (0.008, 0.0), (0.012, 0.0), (0.0, 5.0), (0.0, 10.0), (0.0, 20.0))
"""Offset of the face [m], and tilt [deg], of heads of 0.6 kg at 1.5 m/s."""


def bad_hit_table() -> Iterator[str]:
    """Rows of the table of heads that meet the nail off their middle or tilted."""
    yield "| off centre | tilted | here | MuJoCo | difference |"
    yield "|---|---|---|---|---|"
    for offset, tilt in BAD_HITS:
        ours, theirs = (1e3 * drive(SPEC, 0.6, 1.5, offset, np.deg2rad(tilt)) for drive in (in_pybullet, in_mujoco))
        difference = 100 * (ours / theirs - 1)
        yield f"| {1e3 * offset:.0f} mm | {tilt:.0f}° | {ours:.2f} mm | {theirs:.2f} mm | {difference:+.0f} % |"


def _limits(finger_force: float, friction: float) -> GripLimits:
    return GripLimits.from_contact(finger_force, friction, 0.014, GRIP_WIDTH)


HELD: tuple[tuple[str, Rig], ...] = (
    ("100 N, 0.9", Rig()),
    ("the same, 0.8 m/s", Rig(speed=0.8)),
    ("the same, 1.6 m/s", Rig(speed=1.6)),
    ("the same, 8 mm off centre", Rig(eccentricity=0.008)),
    ("200 N, 0.9", Rig(limits=_limits(200.0, 0.9))),
    ("40 N, 0.9", Rig(limits=_limits(40.0, 0.9))),
    ("40 N, 0.2", Rig(limits=_limits(40.0, 0.2))),
    ("20 N, 0.3", Rig(limits=_limits(20.0, 0.3))),
    ("20 N, 0.3, 1.6 m/s", Rig(limits=_limits(20.0, 0.3), speed=1.6)),
    ("12 N, 0.5", Rig(limits=_limits(12.0, 0.5))),
    ("8 N, 0.9, 1.6 m/s", Rig(limits=_limits(8.0, 0.9), speed=1.6)),
)
"""Finger force and friction of each held strike, and its rig."""


def held_strikes(rig: Rig) -> tuple[HeldStrike, HeldStrike]:
    """One held strike here and in MuJoCo, with the same gains and bounds of the grip."""
    with held_in_pybullet(rig) as held:
        return held.strike(), held_in_mujoco(rig, held.grip.gains)


def held_table() -> Iterator[str]:
    """Rows of the table of held strikes, each figure here and in MuJoCo."""
    yield "| fingers, friction | drive | slip along | largest tilt | tilt left | rebound | wrist |"
    yield "|---|---|---|---|---|---|---|"
    for name, rig in HELD:
        a, b = (strike.row for strike in held_strikes(rig))
        yield (
            f"| {name} | {a[0]:.2f}, {b[0]:.2f} mm | {a[1]:.2f}, {b[1]:.2f} mm | {a[3]:.1f}, {b[3]:.1f}° | "
            f"{a[4]:.1f}, {b[4]:.1f}° | {a[5]:.2f}, {b[5]:.2f} m/s | {a[6]:.1f}, {b[6]:.1f}° |"
        ).replace("-0.00", "0.00")


BY_FRICTION = ((200.0, 0.9), (100.0, 0.9), (60.0, 0.6), (40.0, 0.9), (40.0, 0.2), (20.0, 0.9), (20.0, 0.3), (12.0, 0.5))
"""Finger force [N] and friction of the strikes with a hammer that only friction holds."""


def by_friction(finger_force: float, friction: float) -> tuple[HeldStrike, HeldStrike]:
    """One held strike here, and in MuJoCo with contact and friction alone."""
    rig = Rig(limits=_limits(finger_force, friction))
    with held_in_pybullet(rig) as held:
        return held.strike(), held_by_friction(rig, finger_force, friction)


def friction_table() -> Iterator[str]:
    """Rows of the table of strikes with a hammer that only friction holds, each figure here and in MuJoCo."""
    yield "| fingers | friction | drive | slip along | largest tilt | wrist |"
    yield "|---|---|---|---|---|---|"
    for force, friction in BY_FRICTION:
        a, b = (strike.row for strike in by_friction(force, friction))
        yield (
            f"| {force:.0f} N | {friction} | {a[0]:.2f}, {b[0]:.2f} mm | {a[1]:.2f}, {b[1]:.2f} mm | "
            f"{a[3]:.1f}, {b[3]:.1f}° | {a[6]:.1f}, {b[6]:.1f}° |"
        ).replace("-0.00", "0.00")


def sweep_table() -> Iterator[str]:
    """Rows of the table of the sweep."""
    yield "| friction | fingers | wrist | lost | in a strike | by arithmetic | slip along | across | tilt | drive |"
    yield "|---|---|---|---|---|---|---|---|---|---|"
    for case in cases():
        found = [series(tool, case) for tool in hammers()]
        rows = np.array([strike.row for one in found for strike in one.strikes])
        slips = np.abs(rows[:, 1:3])
        median, worst = np.median(slips, axis=0), slips.max(axis=0)
        lost = sum(one.lost for one in found)
        struck = sum(one.strikes[-1].lost for one in found)
        arithmetic = sum(lost_by_arithmetic(tool, case) for tool in hammers())
        yield (
            f"| {case.friction} | {case.finger_force:.0f} N | {case.wrist_torque} Nm | {lost} of {len(found)} | "
            f"{struck} | {arithmetic} | {median[0]:.2f}, at most {worst[0]:.2f} mm | "
            f"{median[1]:.2f}, at most {worst[1]:.2f} mm | {np.median(rows[:, 3]):.1f}° | "
            f"{np.median(rows[:, 0]):.2f} mm |"
        )
