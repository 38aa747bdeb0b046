"""The held strike in MuJoCo: slip by the solver's own dry friction in series with springs, in steps of 10 microseconds.

The grip is a chain: a joint with dry friction of the grip's bound, then one with its spring and damper, across and
along the handle. Tilting follows the law of `AssistedGrip` (the fingers yield and close again), in finer steps.
"""

from __future__ import annotations

import mujoco
import numpy as np

from tests.cross_checks.held_hammer import (
    CARRIAGE_MASS,
    DURATION,
    FACE_DROP,
    GAP,
    PALM_INERTIA,
    PALM_MASS,
    WRIST_GAIN,
    WRIST_STIFFNESS,
    WRIST_TO_GRIP,
    HeldStrike,
    Rig,
)  # fmt: skip
from tests.cross_checks.held_pybullet import HEAD_LENGTH
from tests.sim_backend.physics.test_nail import FACE_RADIUS
from toolee_robot.sim_backend.physics.grip import RELEASE_SLIP, RELEASE_TILT, TENDON_LOSS, TILT_SLIP, GripGains
from toolee_robot.sim_backend.physics.nail import LUMPED_MASS
from toolee_robot.sim_backend.physics.wood import resistance

TIME_STEP = 1e-5  # [s]
CARRIAGE_SERVO = 5e5  # [N s/m]
LINK = 2e-3  # [kg] of the bodies between friction and spring
NO_BOUND = 1e6

MODEL = """
<mujoco>
  <option timestep="{step}" integrator="implicitfast" cone="elliptic" iterations="100" tolerance="1e-12"/>
  <default>
    <joint solreffriction="{contact} 1" solimpfriction="0.9999 0.9999 0.001"/>
    <geom solref="{contact} 1" solimp="0.99 0.999 0.0001" friction="0.2" contype="0" conaffinity="0"/>
  </default>
  <worldbody>
    <body name="shank">
      <joint name="bend" type="hinge" axis="0 1 0" frictionloss="{plastic}"/>
      <inertial pos="0 0 0" mass="1e-3" diaginertia="1e-7 1e-7 1e-7"/>
      <body name="nail">
        <joint name="nail" type="slide" axis="0 0 -1" frictionloss="1"/>
        <inertial pos="0 0 {protrusion}" mass="{nail}" diaginertia="1e-6 1e-6 1e-6"/>
        <geom type="sphere" size="{nail_radius}" pos="0 0 {nail_center}" contype="1" conaffinity="1"/>
      </body>
    </body>
    <body name="carriage" pos="{wrist_x} 0 {height}">
      <joint name="carriage" type="slide" axis="0 0 -1"/>
      <inertial pos="0 0 0" mass="{carriage}" diaginertia="1 1 1"/>
      <body name="palm">
        <joint name="wrist" type="hinge" axis="0 1 0"/>
        <inertial pos="{to_grip} 0 0" mass="{palm}" diaginertia="{inertia} {inertia} {inertia}"/>
        <body pos="{to_grip} 0 0">
          <joint name="slip_across" type="slide" axis="0 0 1" frictionloss="{across}"/>
          <inertial pos="0 0 0" mass="{link}" diaginertia="1e-6 1e-6 1e-6"/>
          <body>
            <joint name="spring_across" type="slide" axis="0 0 1" stiffness="{stiffness}" damping="{damping}"/>
            <inertial pos="0 0 0" mass="{link}" diaginertia="1e-6 1e-6 1e-6"/>
            <body>
              <joint name="slip_along" type="slide" axis="1 0 0" frictionloss="{along}"/>
              <inertial pos="0 0 0" mass="{link}" diaginertia="1e-6 1e-6 1e-6"/>
              <body name="tool">
                <joint name="spring_along" type="slide" axis="1 0 0" stiffness="{stiffness}" damping="{damping}"/>
                <joint name="tilt" type="hinge" axis="0 1 0"/>
                <inertial pos="{balance} 0 0" mass="{mass}" diaginertia="{moments}"/>
                <geom type="box" size="{face_radius} {face_radius} {head_half}" pos="{reach} 0 {head_center}"
                  contype="1" conaffinity="1"/>
                <site name="face" pos="{reach} 0 -{drop}"/>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


class _Tilt:
    """The torque against a tilt of the handle, by the law of `AssistedGrip`."""

    def __init__(self, gains: GripGains, bound: float) -> None:
        self._gains, self._bound = gains, bound
        self.rest = 0.0
        self._angle = self._bent = 0.0

    def torque(self, angle: float, speed: float, dt: float) -> float:
        """Torque [Nm] at an angle [rad] and its rate [rad/s]; moves the rest by what slips in dt [s]."""
        tilt, bound, gains = angle - self.rest, self._bound, self._gains
        spring = gains.tilt_stiffness * abs(tilt)
        bent = self._bent + gains.tilt_stiffness * (abs(tilt) - self._angle)
        self._angle, self._bent = (
            abs(tilt),
            float(np.clip(bent, min(spring, (1.0 - TENDON_LOSS) * bound), min(spring, bound))),
        )
        if self._bent >= bound:
            self.rest += np.sign(tilt) * TILT_SLIP * max(speed * np.sign(tilt), 0.0) * dt
        bend = np.sign(tilt) * self._bent
        return float(np.clip(-bend - gains.tilt_damping * speed, -bound, bound))


def held_in_mujoco(rig: Rig, gains: GripGains) -> HeldStrike:
    """Strike the nail once."""
    spec, hammer, limits = rig.spec, rig.hammer, rig.limits
    model = mujoco.MjModel.from_xml_string(
        MODEL.format(
            step=TIME_STEP, contact=4 * TIME_STEP, plastic=spec.plastic_moment, protrusion=spec.protrusion,
            nail=LUMPED_MASS, nail_radius=spec.head_diameter / 2,
            nail_center=spec.protrusion - spec.head_diameter / 2,
            wrist_x=-hammer.reach - rig.eccentricity - WRIST_TO_GRIP, height=spec.protrusion + GAP + FACE_DROP,
            carriage=CARRIAGE_MASS, palm=PALM_MASS, inertia=PALM_INERTIA, to_grip=WRIST_TO_GRIP, link=LINK,
            across=min(limits.across, NO_BOUND), along=min(limits.along, NO_BOUND), stiffness=gains.stiffness,
            damping=gains.damping, balance=hammer.balance, mass=hammer.mass, moments=" ".join(map(str, hammer.moments)),
            face_radius=FACE_RADIUS, head_half=HEAD_LENGTH / 2, reach=hammer.reach, drop=FACE_DROP,
            head_center=HEAD_LENGTH / 2 - FACE_DROP,
        )
    )  # fmt: skip
    data = mujoco.MjData(model)
    joint = {model.joint(i).name: i for i in range(model.njnt)}  # every joint has one coordinate
    face = model.site("face").id
    law = _Tilt(gains, limits.tilting)
    data.qvel[joint["carriage"]] = rig.speed
    tilt = rebound = yielded = 0.0
    velocity = np.zeros(6)
    lost = False
    for i in range(round(DURATION / TIME_STEP)):
        q, qd = data.qpos, data.qvel
        lag = rig.carriage_speed(i * TIME_STEP) - float(qd[joint["carriage"]])
        data.qfrc_applied[joint["carriage"]] = CARRIAGE_SERVO * lag
        nail, bend = joint["nail"], abs(float(q[joint["bend"]]))
        model.dof_frictionloss[nail] = resistance(spec, spec.protrusion - float(q[nail]), bend)
        wanted = -WRIST_GAIN * q[joint["wrist"]] - qd[joint["wrist"]]
        data.qfrc_applied[joint["wrist"]] = np.clip(WRIST_STIFFNESS * wanted, -rig.wrist_torque, rig.wrist_torque)
        angle = float(q[joint["tilt"]])
        data.qfrc_applied[joint["tilt"]] = law.torque(angle, float(qd[joint["tilt"]]), TIME_STEP)
        mujoco.mj_step(model, data)
        tilt, yielded = max(tilt, abs(angle)), max(yielded, abs(float(q[joint["wrist"]])))
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, face, velocity, 0)
        rebound = max(rebound, float(velocity[5]))
        slip = np.hypot(q[joint["slip_across"]], q[joint["slip_along"]])
        if slip > RELEASE_SLIP or abs(angle) > RELEASE_TILT:
            lost = True
            break
    q = data.qpos
    return HeldStrike(
        float(q[joint["nail"]]), float(q[joint["slip_along"]]), float(q[joint["slip_across"]]), tilt,
        abs(float(q[joint["tilt"]])), rebound, yielded, lost, finite=bool(np.isfinite(q).all()),
    )  # fmt: skip
