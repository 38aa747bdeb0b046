"""The known hands, one `HandModel` each, and the tool mount.

A new hand is a record: in a file of its own here, which is found by itself, or in a package of a lab, which names it
by an entry point `hand_model.NAME` of the group `toolee_robot.devices`. Its device driver is a `toolee_robot.hal.Hand`
with the record's joints.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Protocol

import numpy as np

from toolee_robot.errors import ConfigError
from toolee_robot.frames import Array, inverse, transform
from toolee_robot.robots.hands.ability import ABILITY_HAND
from toolee_robot.robots.hands.inspire import INSPIRE_RH56
from toolee_robot.robots.hands.model import PALM, UNMOUNTED, Finger, HandModel, NominalGrasp, Phalanx, WristJoint
from toolee_robot.robots.hands.shadow import SHADOW_HAND
from toolee_robot.robots.tree import NEARLY_MASSLESS, Inertial, Link, Shape, Tree
from toolee_robot.runtime.device_plugins import installed, load
from toolee_robot.types import MOUNT, HandMounting, HandWeight, ToolMount

_BROUGHT = [
    (file.name, value)
    for file in iter_modules(__path__)
    for value in vars(import_module(f"{__name__}.{file.name}")).values()
    if isinstance(value, HandModel)
]
HANDS: dict[str, HandModel] = {hand.name: hand for _, hand in _BROUGHT}
"""Name in the station file -> hand: of every file here."""
HAND_FILES: dict[str, str] = {hand.name: file for file, hand in _BROUGHT}
"""Name in the station file -> the file here; that of its driver, and of its emulator, has the same name."""
_ENTRIES = "hand_model"
"""Kind of the entry points by which packages bring models."""


class HandChoice(Protocol):
    """What a station file says of its hand: `config.HandConfig`."""

    @property
    def model(self) -> str:
        """Name of the hand, as for `find_hand`, or `MOUNT`."""

    @property
    def yield_torque(self) -> float | None:
        """Torque above which wrist or mount yields [Nm]; None for the hand's own."""

    @property
    def weighed(self) -> HandWeight | None:
        """What hangs on the flange without a tool; None for the hand's own masses."""

    @property
    def mount(self) -> ToolMount | None:
        """The tool mount; None for a hand."""

    @property
    def mounting(self) -> HandMounting | None:
        """How the hand sits on the flange; None for one whose model says so."""


def hand_model(hand: str | HandChoice) -> HandModel:
    """Look up a hand, or build a tool mount.

    Args:
        hand: Name of the hand, as for `find_hand`; or what the station file says of it.

    Returns:
        The hand, with the station's yield torque, weight and mounting where it gives them. By its name alone, a hand
        that every lab screws on in its own way has no `tree`.

    Raises:
        ConfigError: There is no such hand, the message names those that are known; or it has no wrist that could yield;
            or the station file does not say how it sits on the flange, or says so of a hand whose model does.
    """
    if isinstance(hand, str):
        name, torque, weighed, mount = hand, None, None, None
    else:
        name, torque, weighed, mount = hand.model, hand.yield_torque, hand.weighed, hand.mount
    if mount is not None and torque is not None:
        return mount_model(mount, torque)
    if name == MOUNT:
        raise ConfigError("a tool mount needs its data: give hand.mount and hand.yield_torque in a station file")
    model = find_hand(name)
    if model is None:
        known = ", ".join((*HANDS, *installed(_ENTRIES), MOUNT))
        raise ConfigError(f"there is no hand {name!r} (hand.model in a station file, --hand): choose one of {known}")
    if not isinstance(hand, str):
        model = _mounted(model, hand.mounting)
    return model if torque is None and weighed is None else _with(model, torque, weighed)


def find_hand(name: str) -> HandModel | None:
    """Look up the model of a hand, as it leaves its maker.

    Args:
        name: Its name: a key of `HANDS`, or that of a hand that an installed package brings.

    Returns:
        The model; None where there is none of that name.

    Raises:
        ConfigError: What a package names cannot be imported, or is no such model.
    """
    if name in HANDS:
        return HANDS[name]
    entry = installed(_ENTRIES).get(name)
    if entry is None:
        return None
    model = load(entry)
    if not isinstance(model, HandModel) or model.name != name:
        message = f"{entry.value}, named as {entry.name}, is no HandModel of the name {name!r}"
        raise ConfigError(message)
    return model


@lru_cache(maxsize=8)
def _mounted(hand: HandModel, mounting: HandMounting | None) -> HandModel:
    if mounting is None and hand.mounted:
        return hand
    if mounting is None:
        fields = ", ".join(f"hand.mounting.{name}" for name in HandMounting.__dataclass_fields__)
        message = f"the {hand.label} sits on the flange as a lab screws it on, so there is no default: measure it and"
        raise ConfigError(f"{message} give {fields}")
    if hand.mounted:
        message = f"hand.mounting: the model of the {hand.label} says how it sits on the flange; remove the field"
        raise ConfigError(message)
    at_flange = replace(hand, X_flange_root=np.eye(4))
    X_root_hand = at_flange.tree.link_poses(at_flange.posture("open"))[hand.frame]
    return replace(hand, X_flange_root=mounting.X_flange_hand @ inverse(X_root_hand))


@lru_cache(maxsize=8)
def _with(hand: HandModel, torque: float | None, weighed: HandWeight | None) -> HandModel:
    if torque is None:
        return replace(hand, weighed=weighed)
    index = hand.yielding
    if index is None:
        raise ConfigError(f"hand.yield_torque: the {hand.label} has no wrist that yields; remove the field")
    wrist = (*hand.wrist[:index], replace(hand.wrist[index], torque=torque), *hand.wrist[index + 1 :])
    return replace(hand, wrist=wrist, weighed=weighed)


HINGE = "mount_hinge"
_BODY, _CLAMP, _FRAME = "mount_body", "mount_clamp", "mount"
_CLAMP_SIZE = 0.04  # [m] edge of the cube as which the clamp's inertia is taken
_FASTEST = 20.0  # [rad/s]


@lru_cache(maxsize=8)
def mount_model(mount: ToolMount, yield_torque: float) -> HandModel:
    """Build the model of a tool mount: a hand without fingers, whose wrist is the hinge that yields.

    Args:
        mount: The mount's data.
        yield_torque: Torque above which it yields [Nm].

    Returns:
        The model. Its hand frame is the clamp: x along the handle, z towards the tool's working side.
    """
    tree = _tree(mount, yield_torque)
    return HandModel(
        name=MOUNT,
        label="tool mount",
        source=Path("hand.mount"),
        read=lambda *_: tree,
        X_flange_root=np.eye(4),
        frame=_FRAME,
        wrist=(WristJoint(HINGE, rest=0.0, torque=yield_torque, stiffness=mount.stiffness),),
        fingers=(),
        finger_joints=(),
        forearm=(),
        postures={"open": {}, "preshape": {}, "closed": {}},
        closing_order=(),
        wrapping_order=(),
        grasp=NominalGrasp(z=(1.0, 0.0, 0.0), x=(0.0, 0.0, 1.0), p=(0.0, 0.0, 0.0), p_per_radius=(0.0, 0.0, 0.0)),
        holding_links=0,
        finger_force=0.0,
        grip_width=_CLAMP_SIZE,
        clamps=True,
    )


def _tree(mount: ToolMount, yield_torque: float) -> Tree:
    X_flange_mount = mount.X_flange_mount
    X_flange_hinge = transform(X_flange_mount[:3, :3], mount.hinge_position)
    X_hinge_mount = inverse(X_flange_hinge) @ X_flange_mount
    frame = NEARLY_MASSLESS.mass  # the flange's, and the clamp's
    fixed = mount.mass - mount.clamp_mass - 2 * frame
    moment = mount.mass * np.array(mount.center_of_mass) - (mount.clamp_mass + frame) * np.array(mount.position)
    body = Shape("box", mount.body_size, transform(p=mount.body_position))
    return Tree(
        (
            Link(
                _BODY,
                "tool0",
                np.eye(4),
                f"{_BODY}_mount",
                inertial=_box(fixed, moment / fixed, np.array(mount.body_size)),
                visuals=(body,),
                collisions=(body,),
            ),
            Link(
                _CLAMP,
                _BODY,
                X_flange_hinge,
                HINGE,
                axis=X_flange_hinge[:3, :3].T @ mount.axis,
                lower=0.0,
                upper=mount.travel,
                effort=yield_torque + mount.stiffness * mount.travel,
                velocity=_FASTEST,
                inertial=_box(mount.clamp_mass, X_hinge_mount[:3, 3], np.full(3, _CLAMP_SIZE)),
            ),
            Link(_FRAME, _CLAMP, X_hinge_mount, f"{_FRAME}_fixed", inertial=NEARLY_MASSLESS),
        )
    )


def _box(mass: float, p: Array, size: Array) -> Inertial:
    x, y, z = np.square(size)
    return Inertial(mass, transform(p=p), tuple(mass / 12.0 * np.array([y + z, x + z, x + y])))
