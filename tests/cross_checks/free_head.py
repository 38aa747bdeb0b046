"""A free hammer head strikes a nail, in pybullet as the station simulates it and in MuJoCo; one force law."""

from __future__ import annotations

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
  <default>
    <joint solreffriction="{contact} 1" solimpfriction="0.9999 0.9999 0.001"/>
    <geom solref="{contact} 1" solimp="0.99 0.999 0.0001" friction="0.2"/>
  </default>
  <worldbody>
    <body name="nail">
      <joint name="bend_x" type="hinge" axis="1 0 0" frictionloss="{plastic}"/>
      <joint name="bend_y" type="hinge" axis="0 1 0" frictionloss="{plastic}"/>
      <joint name="slide" type="slide" axis="0 0 -1" frictionloss="1"/>
      <inertial pos="0 0 0" mass="{nail}" diaginertia="1e-6 1e-6 1e-6"/>
      <geom type="cylinder" size="{nail_radius} {nail_half}" pos="0 0 {nail_center}"/>
    </body>
    <body name="head" pos="0 0 {head_center}">
      <freejoint name="head"/>
      <geom type="cylinder" size="{face_radius} {head_half}" mass="{mass}"/>
    </body>
  </worldbody>
</mujoco>
"""


def in_pybullet(spec: NailSpec, mass: float, speed: float, offset: float = 0.0, tilt: float = 0.0) -> float:
    """How far a free head drives the station's nail."""
    return next(make_bench(spec)).strike(mass, speed, offset=offset, tilt=tilt)


def wire_mass(spec: NailSpec) -> float:
    """Mass of the nail [kg]."""
    return float(STEEL_DENSITY * np.pi / 4 * spec.diameter**2 * spec.length)


def in_mujoco(
    spec: NailSpec, mass: float, speed: float, offset: float = 0.0, tilt: float = 0.0, nail: float = LUMPED_MASS
) -> float:
    """How far a free head drives a nail in MuJoCo."""
    model = mujoco.MjModel.from_xml_string(
        MODEL.format(
            step=TIME_STEP, contact=4 * TIME_STEP, plastic=spec.plastic_moment, nail=nail,
            nail_radius=spec.head_diameter / 2, nail_half=HEAD_HEIGHT / 2,
            nail_center=spec.protrusion - HEAD_HEIGHT / 2, face_radius=FACE_RADIUS, head_half=HEAD_LENGTH / 2,
            mass=mass, head_center=0.0,
        )
    )  # fmt: skip
    data = mujoco.MjData(model)
    slide, head = model.joint("slide"), model.joint("head")
    lift = GAP + FACE_RADIUS * np.sin(abs(tilt))
    upwards = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    place = np.array([offset, 0.0, spec.protrusion + lift]) + upwards * HEAD_LENGTH / 2
    turned = [np.cos(tilt / 2), 0.0, np.sin(tilt / 2), 0.0]
    data.qpos[head.qposadr[0] : head.qposadr[0] + 7] = [*place, *turned]
    data.qvel[head.dofadr[0] + 2] = -speed
    for _ in range(round((lift / speed + SETTLING) / TIME_STEP)):
        protrusion = spec.protrusion - float(data.qpos[slide.qposadr[0]])
        model.dof_frictionloss[slide.dofadr[0]] = resistance(spec, protrusion)
        mujoco.mj_step(model, data)
    assert np.all(np.isfinite(data.qpos))
    return float(data.qpos[slide.qposadr[0]])
