"""A held strike in MuJoCo in which nothing but contact and friction holds the hammer.

The handle lies between a palm's plate and four fingers below it, which press with a constant force each. Skin is a soft
contact. Everything else is the rig of `held_mujoco`, in the plane of the strike.
"""

from __future__ import annotations

import mujoco
import numpy as np

from tests.cross_checks.held_hammer import (
    DURATION,
    FACE_DROP,
    GAP,
    GRIP_WIDTH,
    PALM_INERTIA,
    PALM_MASS,
    WRIST_GAIN,
    WRIST_STIFFNESS,
    WRIST_TO_GRIP,
    HeldStrike,
    Rig,
)
from tests.sim_backend.physics.test_nail import FACE_RADIUS
from toolee_robot.sim_backend.physics.grip import RELEASE_SLIP, RELEASE_TILT
from toolee_robot.sim_backend.physics.nail import LUMPED_MASS
from toolee_robot.sim_backend.physics.wood import resistance

TIME_STEP = 2e-5  # [s]
CARRIAGE_SERVO = 1.25e5  # [N s/m]
HANDLE_RADIUS = 0.014  # [m]
FINGERS = (-0.03, -0.01, 0.01, 0.03)  # [m] along the handle
FINGER_MASS = 0.05  # [kg]
FINGER_DAMPING = 20.0  # [N s/m] of the fingers' drives
SKIN_TIME = 0.002  # [s] time constant of the contact with skin
PLATE = 0.005  # [m] half of the plate's and the fingers' thickness
SETTLING = 0.1  # [s] in which the fingers close on the handle

FINGER = """
<body pos="{x} 0 {z}">
  <joint name="finger{i}" type="slide" axis="0 0 1" damping="{damping}"/>
  <inertial pos="0 0 0" mass="{mass}" diaginertia="1e-5 1e-5 1e-5"/>
  <geom class="skin" type="box" size="0.008 0.03 {plate}"/>
</body>
"""
MODEL = """
<mujoco>
  <option timestep="{step}" integrator="implicitfast" cone="elliptic" impratio="100" iterations="100"
    tolerance="1e-12"/>
  <default>
    <joint solreffriction="{contact} 1" solimpfriction="0.9999 0.9999 0.001"/>
    <default class="skin">
      <geom contype="2" conaffinity="2" friction="{friction}" solref="{skin} 1" solimp="0.9 0.95 0.0005"/>
    </default>
    <default class="steel">
      <geom contype="1" conaffinity="1" friction="0.2" solref="{contact} 1" solimp="0.99 0.999 0.0001"/>
    </default>
  </default>
  <worldbody>
    <body>
      <joint name="bend" type="hinge" axis="0 1 0" frictionloss="{plastic}"/>
      <inertial pos="0 0 0" mass="1e-3" diaginertia="1e-7 1e-7 1e-7"/>
      <body>
        <joint name="nail" type="slide" axis="0 0 -1" frictionloss="1"/>
        <inertial pos="0 0 {protrusion}" mass="{nail}" diaginertia="1e-6 1e-6 1e-6"/>
        <geom class="steel" type="sphere" size="{nail_radius}" pos="0 0 {nail_center}"/>
      </body>
    </body>
    <body pos="{wrist_x} 0 {height}">
      <joint name="carriage" type="slide" axis="0 0 -1"/>
      <inertial pos="0 0 0" mass="50" diaginertia="1 1 1"/>
      <body>
        <joint name="wrist" type="hinge" axis="0 1 0"/>
        <inertial pos="{to_grip} 0 0" mass="{palm}" diaginertia="{inertia} {inertia} {inertia}"/>
        <geom class="skin" type="box" size="{half_width} 0.03 {plate}" pos="{to_grip} 0 {plate_z}"/>
        {fingers}
      </body>
    </body>
    <body pos="{grip_x} 0 {height}">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="z" type="slide" axis="0 0 1"/>
      <joint name="turn" type="hinge" axis="0 1 0"/>
      <inertial pos="{balance} 0 0" mass="{mass}" diaginertia="{moments}"/>
      <geom class="skin" type="capsule" size="{radius}" fromto="-0.08 0 0 0.1 0 0"/>
      <geom class="steel" type="box" size="{face} {face} 0.025" pos="{reach} 0 {face_z}"/>
      <site name="face" pos="{reach} 0 -{drop}"/>
    </body>
  </worldbody>
</mujoco>
"""


def held_by_friction(rig: Rig, finger_force: float, friction: float) -> HeldStrike:
    """Strike the nail once."""
    spec, hammer = rig.spec, rig.hammer
    grip_x, height = -hammer.reach - rig.eccentricity, spec.protrusion + GAP + FACE_DROP
    fingers = "".join(
        FINGER.format(
            x=WRIST_TO_GRIP + x, z=-HANDLE_RADIUS - PLATE, i=i, damping=FINGER_DAMPING, mass=FINGER_MASS, plate=PLATE
        )
        for i, x in enumerate(FINGERS)
    )
    model = mujoco.MjModel.from_xml_string(
        MODEL.format(
            step=TIME_STEP, contact=4 * TIME_STEP, friction=friction, skin=SKIN_TIME, plastic=spec.plastic_moment,
            protrusion=spec.protrusion, nail=LUMPED_MASS, nail_radius=spec.head_diameter / 2,
            nail_center=spec.protrusion - spec.head_diameter / 2, wrist_x=grip_x - WRIST_TO_GRIP, height=height,
            to_grip=WRIST_TO_GRIP, palm=PALM_MASS - len(FINGERS) * FINGER_MASS, inertia=PALM_INERTIA, plate=PLATE,
            half_width=GRIP_WIDTH / 2, plate_z=HANDLE_RADIUS + PLATE, fingers=fingers, grip_x=grip_x,
            balance=hammer.balance, mass=hammer.mass, moments=" ".join(map(str, hammer.moments)), radius=HANDLE_RADIUS,
            face=FACE_RADIUS, reach=hammer.reach, face_z=0.025 - FACE_DROP, drop=FACE_DROP,
        )
    )  # fmt: skip
    data = mujoco.MjData(model)
    joint = {model.joint(i).name: i for i in range(model.njnt)}  # every joint has one coordinate
    q, qd, applied = data.qpos, data.qvel, data.qfrc_applied
    applied[[joint[f"finger{i}"] for i in range(len(FINGERS))]] = finger_force / len(FINGERS)
    wrist, carriage = joint["wrist"], joint["carriage"]
    start = np.zeros(2)
    tilt = rebound = yielded = 0.0
    velocity = np.zeros(6)

    def in_hand() -> np.ndarray:
        """Way of the handle's upper surface along the palm [m], and tilt of the handle [rad]."""
        turn, angle = float(q[wrist]), float(q[joint["turn"]] - q[wrist])
        way = [WRIST_TO_GRIP + q[joint["x"]], q[joint["z"]] + q[carriage]]
        along = way[0] * np.cos(turn) - way[1] * np.sin(turn) - WRIST_TO_GRIP
        return np.array([along + HANDLE_RADIUS * np.sin(angle), angle])

    settling, lost = round(SETTLING / TIME_STEP), False
    for i in range(settling + round(DURATION / TIME_STEP)):
        time = (i - settling) * TIME_STEP
        if i == settling:
            qd[carriage], qd[joint["z"]], start = rig.speed, -rig.speed, in_hand()
        wanted = rig.carriage_speed(time) if i >= settling else 0.0
        applied[carriage] = CARRIAGE_SERVO * (wanted - qd[carriage])
        push = WRIST_STIFFNESS * (-WRIST_GAIN * q[wrist] - qd[wrist])
        applied[wrist] = np.clip(push, -rig.wrist_torque, rig.wrist_torque)
        protrusion = spec.protrusion - float(q[joint["nail"]])
        model.dof_frictionloss[joint["nail"]] = resistance(spec, protrusion, abs(float(q[joint["bend"]])))
        mujoco.mj_step(model, data)
        if i >= settling:
            moved = in_hand() - start
            tilt, yielded = max(tilt, abs(float(moved[1]))), max(yielded, abs(float(q[wrist])))
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, model.site("face").id, velocity, 0)
            rebound = max(rebound, float(velocity[5]))
            lost = abs(moved[0]) > RELEASE_SLIP or tilt > RELEASE_TILT
            if lost:
                break
    along, angle = (float(value) for value in in_hand() - start)
    finite = bool(np.isfinite(q).all())
    return HeldStrike(float(q[joint["nail"]]), along, 0.0, tilt, abs(angle), rebound, yielded, lost=lost, finite=finite)
