"""A free hammer head strikes a nail, in pybullet as the station simulates it and in MuJoCo; one force law."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from tests.sim_backend.physics.test_nail import FACE_RADIUS, HEAD_LENGTH, make_bench
from toolee_robot.sim_backend.physics.nail import HEAD_HEIGHT, LUMPED_MASS
from toolee_robot.sim_backend.physics.wood import NailSpec, resistance

STEEL_DENSITY = 7850.0  # [kg/m^3]
TIME_STEP = 1e-5  # [s] of MuJoCo
GAP = 0.003  # [m] between face and nail at the start
SETTLING = 0.025  # [s] after the contact

MODEL = """
<mujoco>
  <option timestep="{step}" gravity="0 0 0" integrator="implicitfast" cone="elliptic" iterations="100"
    tolerance="1e-12"/>
  <default><geom solref="{contact} 1" solimp="0.99 0.999 0.0001" friction="0.2"/></default>
  <worldbody>
    <body name="nail">
      <joint name="slide" type="slide" axis="0 0 -1" frictionloss="1" solreffriction="{contact} 1"
        solimpfriction="0.9999 0.9999 0.001"/>
      <inertial pos="0 0 0" mass="{nail}" diaginertia="1e-6 1e-6 1e-6"/>
      <geom type="cylinder" size="{nail_radius} {nail_half}" pos="0 0 {nail_center}"/>
    </body>
    <body name="head" pos="0 0 {head_center}">
      <freejoint/>
      <geom type="cylinder" size="{face_radius} {head_half}" mass="{mass}"/>
    </body>
  </worldbody>
</mujoco>
"""


@dataclass(frozen=True)
class Blow:
    """What one strike does.

    Attributes:
        driven: How far it drives the nail [m].
        rebound: Speed of the head away from the nail afterwards [m/s].
    """

    driven: float
    rebound: float


def in_pybullet(spec: NailSpec, mass: float, speed: float) -> float:
    """How far the station's nail is driven by a free head of `mass` [kg] at `speed` [m/s]; [m]."""
    return next(make_bench(spec)).strike(mass, speed)


def wire_mass(spec: NailSpec) -> float:
    """Mass of the nail [kg]."""
    return float(STEEL_DENSITY * np.pi / 4 * spec.diameter**2 * spec.length)


def in_mujoco(spec: NailSpec, mass: float, speed: float, nail: float = LUMPED_MASS) -> Blow:
    """A free head of `mass` [kg] at `speed` [m/s] on a nail whose mass is `nail` [kg]."""
    model = mujoco.MjModel.from_xml_string(
        MODEL.format(
            step=TIME_STEP, contact=4 * TIME_STEP, nail=nail, nail_radius=spec.head_diameter / 2,
            nail_half=HEAD_HEIGHT / 2, nail_center=spec.protrusion - HEAD_HEIGHT / 2, face_radius=FACE_RADIUS,
            head_half=HEAD_LENGTH / 2, mass=mass, head_center=spec.protrusion + GAP + HEAD_LENGTH / 2,
        )
    )  # fmt: skip
    data = mujoco.MjData(model)
    data.qvel[3] = -speed  # of the free joint, after the nail's slide
    for _ in range(round((GAP / speed + SETTLING) / TIME_STEP)):
        model.dof_frictionloss[0] = resistance(spec, spec.protrusion - float(data.qpos[0]))
        mujoco.mj_step(model, data)
    assert np.all(np.isfinite(data.qpos))
    return Blow(float(data.qpos[0]), float(data.qvel[3]))
