"""`HandModel`: everything that the project knows of a hand, as data.

The hand frame, which every hand has to provide as a link: origin at the root of the palm, z distal (towards the
fingers), x radial (towards the thumb of a right hand), y out of the back of the hand; the palm faces -y. Handles lie
across the palm: `NominalGrasp`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import trimesh

from toolee_robot.errors import AssetError, ConfigError
from toolee_robot.frames import Array, frame_from_axes, inverse
from toolee_robot.robots.tree import FLANGE_FRAME, Tree, link_mesh
from toolee_robot.types import HandWeight

PALM = "palm"
"""Part of the links that belong neither to a finger nor to the forearm."""

UNMOUNTED = np.full((4, 4), np.nan)
"""Mount of a hand that every lab screws on in its own way: the station file has to say how (`hand.mounting`)."""

Read = Callable[[Path, str, Array], Tree]
"""A reader of a hand's model: its file, the link that carries it, and the pose (4x4) of its root link in that link."""


@dataclass(frozen=True)
class Phalanx:
    """A finger's segment as a capsule around the z axis of its link, from the link's origin on."""

    link: str
    """Name of the link."""
    radius: float
    """Radius of the capsule [m]."""
    length: float
    """Length of the capsule's axis [m]."""


@dataclass(frozen=True)
class Finger:
    """A finger: the links whose contacts count as its own, and the segments that close around a handle."""

    name: str
    """As `hal.HandState.contact_forces` names it: "thumb", "index", "middle", "ring", "little", or the maker's name."""
    links: tuple[str, ...]
    """All its links, the knuckle first."""
    phalanges: tuple[Phalanx, ...]
    """Its segments from the palm outwards; the last one carries the finger tip."""


@dataclass(frozen=True)
class WristJoint:
    """A joint between the hand's mount and its palm."""

    name: str
    """Name of the joint."""
    rest: float
    """Position while the arm works [rad]."""
    torque: float = np.inf
    """Most that it holds against while hammering [Nm]: beyond it the wrist yields instead of the grip. The motor's own
    limit holds too."""
    stiffness: float = 0.0
    """Torque that it holds beyond `torque`, by angle from rest [Nm/rad]."""
    shown: tuple[float, float] = (0.0, 0.0)
    """Range of positions in synthetic images [rad]."""


@dataclass(frozen=True)
class NominalGrasp:
    """Pose of a round handle in the closed hand, for every radius.

    The axes are fixed, the centre moves with the radius; all in the hand frame. The `tool` frame: z along the handle, x
    to the working side.
    """

    z: tuple[float, float, float]
    """Direction of the tool's z axis, a unit vector."""
    x: tuple[float, float, float]
    """Direction of the tool's x axis, a unit vector."""
    p: tuple[float, float, float]
    """Centre of a handle of radius 0 [m]."""
    p_per_radius: tuple[float, float, float]
    """How the centre moves with the radius [m/m]: away from what the handle touches."""

    @property
    def R_hand_tool(self) -> Array:
        """Axes of the tool in the hand, 3x3."""
        return self.X_hand_tool(0.0)[:3, :3]

    def X_hand_tool(self, handle_radius: float) -> Array:
        """Nominal pose of the tool in the hand.

        Args:
            handle_radius: Radius of the handle at the grip centre [m].

        Returns:
            X_hand_tool, 4x4.
        """
        p = [p + k * handle_radius for p, k in zip(self.p, self.p_per_radius, strict=True)]
        return frame_from_axes(z=np.array(self.z), x=np.array(self.x), p=p)


@dataclass(frozen=True, eq=False)
class HandModel:
    """One hand with what carries it: the file of its links, its frame, joints, fingers, postures and nominal grasp.

    Add one to `toolee_robot.robots.hands.HANDS` and a station file can name it. Positions are in rad throughout.
    """

    name: str
    """As a station file names it."""
    label: str
    """For people."""
    source: Path
    """The hand's model file, its meshes beside it."""
    read: Read
    """Reads `source`: `toolee_robot.robots.urdf.read_urdf`, or a reader of its own."""
    X_flange_root: Array
    """Pose (4x4) of the hand's root link in the flange: its mount. `UNMOUNTED` where only the lab knows it."""
    frame: str
    """Link that is the hand frame (see the module's docstring)."""
    wrist: tuple[WristJoint, ...]
    """Joints between mount and palm, from the mount on; none in most hands."""
    fingers: tuple[Finger, ...]
    """The fingers, the one that opposes the others first."""
    finger_joints: tuple[str, ...]
    """The fingers' joints in the order of the model file."""
    forearm: tuple[str, ...]
    """Links between flange and palm."""
    postures: Mapping[str, Mapping[str, float]]
    """Finger joint -> position of "open" (palm free, to lay a handle in), "preshape" (half bent around one) and
    "closed" (bent further than any handle allows, so that the fingers press); joints that are not named are at 0."""
    closing_order: tuple[tuple[str, ...], ...]
    """Joints that close together, group after group, in a real grasp; opening goes the other way."""
    wrapping_order: tuple[tuple[str, ...], ...]
    """Likewise where no physics engine closes the hand (`wrap_fingers`): joints that bend phalanges."""
    grasp: NominalGrasp
    """How it holds a handle."""
    holding_links: int
    """Links of the other fingers that must touch, besides the opposing one, for a hold."""
    finger_force: float
    """Most that one finger presses with [N]."""
    grip_width: float
    """Width across the fingers that hold, along the handle [m]."""
    clamps: bool = False
    """Whether it is a mount, in which a person fixes the tool: it neither closes nor opens, and senses no hold."""
    mesh_cell: float = 0.0042
    """Meshes are thinned to this size for rendering and planning [m]."""
    root_mesh_cell: float = 0.0042
    """Likewise the root link's."""
    weighed: HandWeight | None = None
    """What hangs on the flange without a tool, as a station has weighed it; None: the links' masses."""

    def __post_init__(self) -> None:
        known = set(self.joints)
        named = {j for group in (*self.closing_order, *self.wrapping_order) for j in group}
        named.update(j for posture in self.postures.values() for j in posture)
        if not named <= known or set(self.postures) != {"open", "preshape", "closed"}:
            raise ValueError(
                f"{self.label}: postures are open, preshape and closed, and {sorted(named - known)} must be joints"
            )

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of all its joints, (n,): the wrist's, then the fingers'."""
        return (*(joint.name for joint in self.wrist), *self.finger_joints)

    @property
    def mounted(self) -> bool:
        """Whether it is known how the hand sits on the flange."""
        return self.X_flange_root is not UNMOUNTED

    @property
    def wrist_index(self) -> list[int]:
        """Places of the wrist's joints in `joints`."""
        return list(range(len(self.wrist)))

    @property
    def yielding(self) -> int | None:
        """Place in `joints` of the wrist's joint that yields in a strike; None where none does."""
        return next((i for i, joint in enumerate(self.wrist) if np.isfinite(joint.torque)), None)

    @property
    def yield_torque(self) -> float | None:
        """Torque above which the wrist or the mount yields in a strike [Nm]; None where nothing does."""
        return None if self.yielding is None else self.wrist[self.yielding].torque

    @property
    def opposing(self) -> Finger:
        """The finger that opposes the others."""
        return self.fingers[0]

    def index(self, joints: tuple[str, ...]) -> list[int]:
        """Places of the joints in `joints`."""
        return [self.joints.index(joint) for joint in joints]

    def posture(self, name: str) -> Array:
        """Joint positions (n,) [rad] of one of `postures`, the wrist at rest."""
        at = {**self.postures[name], **{joint.name: joint.rest for joint in self.wrist}}
        return np.array([at.get(joint, 0.0) for joint in self.joints])

    def part_of(self, link: str) -> str:
        """Which finger a link of the hand belongs to, by name; `PALM` for all others."""
        return self._part.get(link, PALM)

    @cached_property
    def _part(self) -> dict[str, str]:
        return {link: finger.name for finger in self.fingers for link in finger.links}

    @cached_property
    def tips(self) -> frozenset[str]:
        """Links of the finger tips."""
        return frozenset(finger.phalanges[-1].link for finger in self.fingers)

    @cached_property
    def tree(self) -> Tree:
        """The hand's links, rooted in its mount on the flange.

        Raises:
            ConfigError: How the hand sits on the flange is not known.
            AssetError: The model file cannot be read, or has other joints or no link for the hand frame.
        """
        if not self.mounted:
            raise ConfigError(f"the {self.label} sits on the flange as a lab screws it on: give hand.mounting")
        tree = self.read(self.source, FLANGE_FRAME, self.X_flange_root)
        if tree.joints != self.joints:
            raise AssetError(f"{self.source}: its joints are {tree.joints}, the {self.label}'s are {self.joints}")
        if self.frame not in tree.by_name:
            raise AssetError(f"{self.source} has no link {self.frame!r}, the hand frame")
        return tree

    def link_poses(self, q_hand: Array) -> dict[str, Array]:
        """X_hand_link (4x4) of every link, forearm included, at q_hand (n,) [rad] in the order of `joints`."""
        poses = self.tree.link_poses(q_hand)
        X_hand_flange = inverse(poses[self.frame])
        return {name: X_hand_flange @ X for name, X in poses.items()}

    @cached_property
    def meshes(self) -> dict[str, trimesh.Trimesh]:
        """Link -> mesh in the link's frame [m], thinned to `mesh_cell`."""
        found = {}
        for i, link in enumerate(self.tree.links):
            mesh = link_mesh(link, self.mesh_cell if i else self.root_mesh_cell)
            if mesh is not None:
                found[link.name] = mesh
        return found


_ALONG = np.linspace(0.0, 1.0, 7)


def wrap_fingers(
    hand: HandModel, X_hand_tool: Array, handle_radius: float, half_length: float = 0.06, press: float = 0.0005
) -> Array:
    """Close a hand around a round handle: the joint groups close in turn, each until contact with the handle.

    Args:
        hand: The hand; its `wrapping_order` gives the joint groups.
        X_hand_tool: Pose of the tool in the hand frame, 4x4 [m].
        handle_radius: Radius of the handle [m].
        half_length: Half-length of the handle, centred on the origin of the tool [m].
        press: Permitted penetration of a finger into the handle [m].

    Returns:
        Joint positions (n,) [rad].
    """
    q = hand.posture("open")
    closed = hand.posture("closed")
    for joints in hand.wrapping_order:
        links = [hand.tree.carried_by(joint) for joint in joints]
        fingers = [_finger(hand, link) for link in links]
        radii = np.array([[phalanx.radius for phalanx in finger.phalanges] for finger in fingers])
        reach = (radii + handle_radius - press)[:, :, None]
        index = hand.index(joints)
        centre, cosine, sine = _circles(hand, q, X_hand_tool, fingers, links)
        low, high = q[index], closed[index]
        for k in range(9):
            trial = high if k == 0 else 0.5 * (low + high)
            turn = (trial - q[index])[:, None, None, None]
            points = centre + np.cos(turn) * cosine + np.sin(turn) * sine
            points[..., 2] -= np.clip(points[..., 2], -half_length, half_length)
            free = (np.sqrt(np.einsum("fpni,fpni->fpn", points, points)) > reach).all(axis=(1, 2))
            low, high = np.where(free, trial, low), np.where(free, high, trial)
        q[index] = low
    return q


def _finger(hand: HandModel, link: str) -> Finger:
    return next(finger for finger in hand.fingers if link in finger.links)


def _circles(
    hand: HandModel, q_hand: Array, X_hand_tool: Array, fingers: list[Finger], links: list[str]
) -> tuple[Array, Array, Array]:
    """Circles of the points on the phalanx axes as one joint of each finger rotates by `a` from q_hand (n,) [rad].

    The point positions are centre + cos(a) cosine + sin(a) sine. The joint of each link in `links` moves the phalanges
    from that link on.

    Returns:
        centre, cosine and sine, each (fingers, phalanges, 7 points, 3) [m], `tool` frame.
    """
    tree = hand.tree
    poses = tree.link_poses(q_hand)
    X_tool_root = inverse(poses[hand.frame] @ X_hand_tool)
    Xs = X_tool_root @ np.array([[poses[phalanx.link] for phalanx in finger.phalanges] for finger in fingers])
    lengths = np.array([[phalanx.length for phalanx in finger.phalanges] for finger in fingers])
    along = (lengths[:, :, None] * _ALONG)[..., None]
    points = Xs[:, :, None, :3, 3] + along * Xs[:, :, None, :3, 2]
    Xs_tool_link = X_tool_root @ np.array([poses[link] for link in links])
    axes = np.array([tree.by_name[link].axis for link in links])
    axis = (Xs_tool_link[:, :3, :3] @ axes[..., None])[:, None, None, :, 0]
    moved = np.array(
        [
            [link in tree.ancestors(phalanx.link) for phalanx in finger.phalanges]
            for finger, link in zip(fingers, links, strict=True)
        ]
    )[:, :, None, None]
    arm = points - Xs_tool_link[:, None, None, :3, 3]
    cosine = np.where(moved, arm - (arm * axis).sum(axis=-1, keepdims=True) * axis, 0.0)
    sine = np.where(moved, np.cross(axis, arm), 0.0)
    return points - cosine, cosine, sine
