"""A bolt with a nut on the block, in the place of wood and nail: world, visuals, station and ground truth.

The bolt is no body of the physics engine. `physics.nut` says how jaw and nut move each other; what that means for the
tool is applied to it as a force and a torque, as the grip's are.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array, frame_from_axes, inverse, rotation_z, transform
from toolee_robot.hal import Station
from toolee_robot.render.mesh import cylinder
from toolee_robot.sim_backend.devices.arm import SimArm
from toolee_robot.sim_backend.devices.camera import SimCamera
from toolee_robot.sim_backend.devices.operator import SimPerson
from toolee_robot.sim_backend.judge import PoseHistory
from toolee_robot.sim_backend.options import InHandOffset, SimOptions
from toolee_robot.sim_backend.physics.bodies import IMPACT, StepSettings, pb, rotation_matrix
from toolee_robot.sim_backend.physics.nail import Nail
from toolee_robot.sim_backend.physics.nut import LARGEST_TILT, SIXTH, SLIPPING_TORQUE, Fit, Jaw, JawPlace, Nut, NutSpec
from toolee_robot.sim_backend.station import simulated_hand
from toolee_robot.sim_backend.truth import PoseError, pose_error
from toolee_robot.sim_backend.visuals import BodyId, SceneVisuals, VisualBody, scene_state
from toolee_robot.sim_backend.world import NORMAL, QUANTUM, SimClock, SimWorld
from toolee_robot.station import SIMULATED, StationConfig, WorkConfig, check_upright
from toolee_robot.tools import Tool
from toolee_robot.tools.gripped_wrenches import JAW_TURN, gripped_wrench
from toolee_robot.types import InHandEstimate

AT_NUT = StepSettings(time_step=2 * QUANTUM, iterations=50, contact_erp=0.2)
"""Settings of the steps while the jaw is near the nut."""
NEAR = 0.04
"""Distance of the jaw from the nut's axis from which on these steps are used [m]."""
STIFFNESS, DAMPING = 3e4, 6.0
"""Of jaw against nut across its flats and at its corners [N/m], [N s/m]: what such steps keep stable for a wrench of
0.1 to 0.16 kg. Steel is a thousand times as stiff; the hand is the softer part."""
TURN_STIFFNESS, TURN_DAMPING = 500.0, 0.05
"""About the nut's axis [Nm/rad], [Nm s/rad]."""
TILT_STIFFNESS = 8.0
"""Against a tilt of the jaw on the nut [Nm/rad]; a handle that turns in the hand bears no more in such steps."""


@dataclass(frozen=True)
class Bolt:
    """What stands on the block.

    Attributes:
        spec: Nut and joint.
        jaw: Jaw of the wrench that fits it.
        flats: Angle of the nut's flats at the beginning, about the bolt's axis into the block [rad].
    """

    spec: NutSpec = field(default_factory=NutSpec)
    jaw: Jaw = field(default_factory=Jaw)
    flats: float = 0.0

    @classmethod
    def draw(cls, seed: int) -> Bolt:
        """Draw nut, joint and jaw within their tolerances.

        Args:
            seed: Seed of the run.

        Returns:
            The bolt.
        """
        rng = np.random.default_rng([seed, 40])
        spec, opening = NutSpec.draw(rng), float(rng.uniform(0.01304, 0.01324))
        return cls(spec, Jaw(opening, 0.52 * opening), float(rng.uniform(0.0, SIXTH)))


def X_base_bolt(work: WorkConfig) -> Array:
    """Pose of the middle of the nut, (4, 4): z into the block, x along x of `base`, as far as it can be.

    A station file's work has a nail; its head's place and height are those of the nut.
    """
    axis = -work.nail_axis
    return frame_from_axes(z=axis, x=np.array([1.0, 0.0, 0.0]), p=work.p_base_entry - work.nail_protrusion * axis)


class BoltWorld(SimWorld):
    """The simulated world with a bolt.

    Args:
        config: The station.
        tool: The wrench.
        X_base_tool: Its initial pose, (4, 4).
        options: Options of the run.
        bolt: What stands on the block.

    Attributes:
        nut: The nut.
        X_base_nut: Pose of its middle at angle 0, (4, 4).
        fit: How the jaw stands to it.
        slips: How often the jaw has slipped off under load.
    """

    def __init__(self, config: StationConfig, tool: Tool, X_base_tool: Array, options: SimOptions, bolt: Bolt) -> None:
        super().__init__(config, tool, X_base_tool, options)
        self.jaw, self.nut = bolt.jaw, Nut(bolt.spec)
        self.X_base_nut = X_base_bolt(config.work) @ transform(rotation_z(bolt.flats))
        self.fit, self.slips = Fit.APART, 0
        self._X_tool_ee = tool.ee(Category.WRENCH_HEAD).X_tool_ee
        X = inverse(self.tool.X_tool_inertial) @ self._X_tool_ee
        self._p_ee, self._R_ee = X[:3, 3], X[:3, :3]
        self._slot = rotation_z(JAW_TURN) @ [-1.0, 0.0, 0.0]  # out of the mouth, axes of the end effector
        self._angle = self._offset = self._turning = 0.0
        self._slipped = False
        self.before_step.append(self._at_nut)

    def _driven_in(self, options: SimOptions) -> dict[str, Nail]:  # noqa: ARG002
        return {}

    def X_base_ee(self) -> Array:
        """Pose of the jaw, 4x4; ground truth."""
        return self.X_base_tool() @ self._X_tool_ee

    def _jaw_now(self) -> tuple[Array, Array, Array]:
        """Middle of the jaw from the centre of mass and in `base`, (3,) [m] each, and its axes, (3, 3)."""
        p, quaternion = pb.getBasePositionAndOrientation(self.tool_body, physicsClientId=self.client)
        R = rotation_matrix(quaternion)
        arm = R @ self._p_ee
        return arm, p + arm, R @ self._R_ee

    def _settings_of_step(self, most: int) -> StepSettings:
        if most >= 2 and math.dist(self._jaw_now()[1], self.X_base_nut[:3, 3]) < NEAR:
            return AT_NUT
        return IMPACT if most < 4 else NORMAL

    def _at_nut(self, dt: float) -> None:  # noqa: ARG002
        """Apply force and torque of the nut to the wrench."""
        arm, middle, R_ee = self._jaw_now()
        way, axis, before = self.X_base_nut[:3, 3] - middle, self.X_base_nut[:3, 2], self.fit
        if way @ way > NEAR**2:  # the usual case, kept cheap
            self.fit = Fit.APART
            return
        slot = R_ee @ self._slot
        across = np.cross(R_ee[:, 2], slot)
        tilt = math.acos(min(max(float(R_ee[:, 2] @ axis), -1.0), 1.0))
        place = JawPlace(float(way @ slot), float(way @ across), float(way @ axis), tilt)
        now = math.atan2(self.X_base_nut[:3, 1] @ slot, self.X_base_nut[:3, 0] @ slot)
        self._angle += math.remainder(now - self._angle, 2.0 * math.pi)
        turned = math.remainder(self._angle - self.nut.angle, SIXTH)
        self.fit = self.jaw.fit(self.nut.spec, place, before, turned)
        if self.fit is Fit.APART:
            self.slips += before is Fit.ON and self._turning > SLIPPING_TORQUE  # over the nut, or under it
            self._slipped, self._turning = False, 0.0
            return
        if before is Fit.APART:
            self._offset = self._angle - self.nut.angle - turned
        v, w = (np.array(u) for u in pb.getBaseVelocity(self.tool_body, physicsClientId=self.client))
        force = self._reaction(place, slot, across, v + np.cross(w, arm))
        torque = self._turn_nut(place, float(w @ axis), slipping=before is Fit.ON) * axis
        if self.fit is Fit.ON and tilt < LARGEST_TILT:
            torque = torque + TILT_STIFFNESS * np.cross(R_ee[:, 2], axis)
        body, client = self.tool_body, self.client
        point = self.X_base_nut[:3, 3].tolist()
        pb.applyExternalForce(body, -1, force.tolist(), point, pb.WORLD_FRAME, physicsClientId=client)
        pb.applyExternalTorque(body, -1, torque.tolist(), pb.WORLD_FRAME, physicsClientId=client)

    def _turn_nut(self, place: JawPlace, speed: float, *, slipping: bool) -> float:
        """Turn the nut with the jaw: torque on the jaw about the nut's axis [Nm]."""
        self._turning = 0.0
        if self.fit is Fit.BLOCKED or self._slipped:
            return 0.0
        spec = self.nut.spec
        torque = self.nut.follow(self._angle - self._offset, self.jaw.play(spec, place.along), TURN_STIFFNESS)
        if slipping and self.jaw.slips(spec, place, torque):
            self.slips, self._slipped = self.slips + 1, True
            return 0.0
        self._turning = abs(torque)
        return torque - TURN_DAMPING * speed if torque else 0.0

    def _reaction(self, place: JawPlace, slot: Array, across: Array, velocity: Array) -> Array:
        """Force of the nut on the jaw, but for what turns it, (3,) [N]."""
        spec, jaw = self.nut.spec, self.jaw
        along, beside = 0.0, 0.0
        depth = jaw.depth(spec, place.along)
        if self.fit is Fit.BLOCKED:
            along = -STIFFNESS * min(depth, 0.5 * spec.flat)
        else:
            pressed = abs(place.beside) - jaw.room(spec, place.along)
            if pressed > 0.0:
                side = math.copysign(1.0, place.beside)
                if depth < 0.5 * spec.flat:  # on the slanted flats before it
                    beside, along = 0.25 * side * STIFFNESS * pressed, -0.433 * STIFFNESS * pressed
                else:
                    beside = side * STIFFNESS * pressed - DAMPING * float(velocity @ across)
            bottom = spec.flat - jaw.half_length - 0.0015 - place.along
            if bottom > 0.0:
                along -= STIFFNESS * bottom
        if along:
            along -= DAMPING * float(velocity @ slot)
        return np.asarray(along * slot + beside * across)


@dataclass(frozen=True)
class NutVerdict:
    """What became of the nut, and how good the first estimate was.

    Attributes:
        torque: Torque with which the nut is tightened [Nm].
        turned: Angle that it has turned [rad].
        slips: How often the jaw slipped off it under load.
        error: Error of the last in-hand estimate; None where there was none.
    """

    torque: float
    turned: float
    slips: int
    error: PoseError | None


class BoltJudge(PoseHistory):
    """Ground truth of a run: poses of the jaw in the hand, and the nut."""

    def __init__(self, world: BoltWorld) -> None:
        super().__init__(world)
        self._bolt = world

    def verdict(self, estimates: Sequence[tuple[float, InHandEstimate]] = ()) -> NutVerdict:
        """What became of the nut.

        Args:
            estimates: Stamp [s] and estimate of each look.

        Returns:
            The verdict.
        """
        nut, error = self._bolt.nut, None
        if estimates:
            stamp, estimate = estimates[-1]
            error = pose_error(estimate.X_hand_ee, self.X_hand_ee(stamp), Category.WRENCH_HEAD)
        return NutVerdict(nut.torque if nut.angle > nut.spec.run else nut.largest, nut.angle, self._bolt.slips, error)


STEEL = (0.62, 0.62, 0.66)


class BoltVisuals(SceneVisuals):
    """The visual bodies of a station with a bolt."""

    world: BoltWorld

    def follow(self, world: BoltWorld) -> None:
        """Show the bolt of a world."""
        self.world = world
        spec, height = world.nut.spec, world.config.work.nail_protrusion - 0.5 * world.nut.spec.height
        radius = 0.5 * spec.across_flats
        self._bolt = [
            ("bolt sleeve", cylinder(0.9 * radius, height), 0.5 * spec.height + 0.5 * height),
            ("bolt end", cylinder(0.004, 0.008), -0.5 * spec.height - 0.004),
            ("nut", cylinder(spec.flat, spec.height, 6), 0.0),
        ]

    def visual_bodies(self) -> Sequence[VisualBody]:
        """The current visual bodies, without the room."""
        X = self.world.X_base_nut @ transform(rotation_z(self.world.nut.angle))
        parts = [(name, mesh, X @ transform(p=[0.0, 0.0, z])) for name, mesh, z in self._bolt]
        bolt = [VisualBody(n, mesh, at, "steel_bright", STEEL, 0.35, 1.0, body_id=BodyId.NAIL) for n, mesh, at in parts]
        return [*super().visual_bodies(), *bolt]


@dataclass(frozen=True, eq=False)
class BoltStation:
    """A simulated station with a bolt.

    Attributes:
        station: The devices: all that a task may use.
        world: The simulated world: ground truth.
        judge: What truly happened: ground truth.
    """

    station: Station
    world: BoltWorld
    judge: BoltJudge


@contextmanager
def bolt_station(config: StationConfig, seed: int, options: SimOptions, bolt: Bolt) -> Iterator[BoltStation]:
    """Context of a simulated station with a bolt.

    Args:
        config: The station.
        seed: Seed of wrench, in-hand offset, room and noise.
        options: Options of the run.
        bolt: What stands on the block.

    Yields:
        The station.
    """
    check_upright(config.arm, "the simulated world")
    tool = gripped_wrench(bolt.jaw.opening, seed)
    offset = InHandOffset.of_job(seed) if options.offset is None else options.offset
    x, y, _ = config.scene.person_center
    world = BoltWorld(config, tool, transform(p=[x, y + 0.35, 1.0]), options, bolt)
    try:
        person, clock = SimPerson(world, offset, options.hands_over), SimClock(world)
        visuals = BoltVisuals(config, tool, seed, lambda: scene_state(world, person))
        visuals.follow(world)
        camera = SimCamera(visuals, clock, config.camera.uncalibrated, seed, options.sensor)
        arm = SimArm(world, options.wrench_errors, [seed, 13])
        station = Station(arm, simulated_hand(world, options), camera, person, clock, SIMULATED, SIMULATED)
        judge = BoltJudge(world)
        world.after_step.append(judge.after_step)
        yield BoltStation(station, world, judge)
    finally:
        world.close()
