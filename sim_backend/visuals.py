"""Visual bodies of the world: robot, tool, work and person as meshes at their current poses."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

import numpy as np

from toolee_robot.frames import Array, frame_from_axes, transform
from toolee_robot.render.material import skin_tone
from toolee_robot.render.mesh import Mesh, box, cylinder, sphere
from toolee_robot.robots import arm_meshes, hand_model
from toolee_robot.robots.tree import FLANGE_FRAME
from toolee_robot.sim_backend.options import PlacedBoard
from toolee_robot.sim_backend.physics.bodies import OBSTACLE_COLOR
from toolee_robot.sim_backend.physics.wood import NailSpec
from toolee_robot.sim_backend.world import SimWorld
from toolee_robot.station import StationConfig
from toolee_robot.tools import Tool


@dataclass(frozen=True, eq=False)
class VisualBody:
    """One visible rigid body.

    Attributes:
        name: Unique and stable name, which also seeds the surface pattern.
        mesh: Mesh in the body's frame; built once and kept.
        X_base_body: Current pose, 4x4.
        finish: Material for the texture ("wood", "steel_bright", "rubber", "plastic", "skin", ...), see
            `toolee_robot.render.material.finish`.
        color: Color, sRGB in [0, 1].
        roughness: Roughness of the surface in [0, 1].
        metallic: Metalness of the surface in [0, 1].
        grain_axis: Body axis of a wood's grain: 0, 1 or 2.
        body_id: Id in ground-truth renderings, at least 1; parts of one object share it.
    """

    name: str
    mesh: Mesh
    X_base_body: Array
    finish: str
    color: tuple[float, float, float]
    roughness: float = 0.5
    metallic: float = 0.0
    grain_axis: int = 2
    body_id: int = 1


class VisualWorld(Protocol):
    """A world that can be rendered.

    Attributes:
        table_height: Height of the table's top over the base plane [m].
    """

    table_height: float

    def visual_bodies(self) -> Sequence[VisualBody]:
        """The visual bodies at the current simulated time, without the room."""


MARGIN = 0.015
"""White margin around the squares [m]."""
_THICKNESS = 0.001
"""Thickness of the sheet, behind the printed plane [m]."""
_INK = 5e-5
"""Distance of the black faces before the sheet [m]."""
BOARD_ID = 7
"""Id of the board in ground-truth renderings."""


class BoardVisuals:
    """The visual bodies of a board; meshes are built once.

    Args:
        placed: The board.
    """

    def __init__(self, placed: PlacedBoard) -> None:
        self.placed = placed
        width, height = placed.board.size
        self._sheet = box((width + 2 * MARGIN, height + 2 * MARGIN, _THICKNESS))
        self._X_board_sheet = transform(p=placed.board.center + np.array([0.0, 0.0, _THICKNESS / 2]))
        self._ink = _faces(placed.board.rectangles)

    def bodies(self, X_base_flange: Array) -> Iterator[VisualBody]:
        """The visual bodies.

        Args:
            X_base_flange: Present pose of the flange, (4, 4).

        Yields:
            The sheet, and its black faces.
        """
        X = self.placed.X_frame_board
        if self.placed.on_flange:
            X = X_base_flange @ X
        white, black = (0.93, 0.93, 0.92), (0.05, 0.05, 0.05)
        yield VisualBody("board_sheet", self._sheet, X @ self._X_board_sheet, "paper", white, 0.9, body_id=BOARD_ID)
        yield VisualBody("board_ink", self._ink, X, "paper", black, 0.9, body_id=BOARD_ID)


def _faces(rectangles: Array) -> Mesh:
    """Rectangles (R, 4) as faces that look along -z."""
    x, y, w, h = rectangles.T
    z = np.full(len(x), -_INK)
    corners = np.stack([[x, y, z], [x + w, y, z], [x + w, y + h, z], [x, y + h, z]])  # (4, 3, R)
    vertices = corners.transpose(2, 0, 1).reshape(-1, 3)
    first = 4 * np.arange(len(x))[:, None]
    faces = np.concatenate([first + np.array(corner) for corner in ((0, 2, 1), (0, 3, 2))])
    return Mesh.build(vertices, faces)


Color = tuple[float, float, float]
SHIRT_COLORS: tuple[Color, ...] = ((0.2, 0.3, 0.5), (0.5, 0.2, 0.2), (0.25, 0.4, 0.3), (0.35, 0.35, 0.38))


_HEAD, _SHANK = "nail head ", "nail shank "
"""Names of a nail's visual bodies, before its own."""
STAND_COLOR: Color = (0.30, 0.32, 0.36)
PINE_COLOR: Color = (0.80, 0.66, 0.46)


class BodyId(IntEnum):
    """Ids of the visual bodies."""

    ARM = 1
    HAND = 2
    TOOL = 3
    WORK = 4
    NAIL = 5
    PERSON = 6


@dataclass(frozen=True)
class SceneState:
    """Poses of everything visible at one time, 4x4 in `base`.

    Attributes:
        links: Pose of each robot link, by its name.
        X_base_tool: Pose of the tool.
        Xs_base_nail: Pose of each nail's head, by the nail's name.
        person_center: Middle of the person's body, (3,) [m].
        person_arm: Shoulder and hand, (3,) each [m], while the person holds the tool, else None.
    """

    links: Mapping[str, Array]
    X_base_tool: Array
    Xs_base_nail: Mapping[str, Array]
    person_center: Array
    person_arm: tuple[Array, Array] | None


class VisiblePerson(Protocol):
    """The person of the simulated world, as far as a camera sees them.

    Attributes:
        center: Middle of the body (3,) in `base` [m].
        visible_arm: Shoulder and hand (3,) in `base` [m] while the person holds the tool, else None.
    """

    center: Array
    visible_arm: tuple[Array, Array] | None


def scene_state(world: SimWorld, person: VisiblePerson) -> SceneState:
    """The current state of a world.

    Args:
        world: The simulated world.
        person: The simulated person.

    Returns:
        The poses of everything visible.
    """
    links = world.robot.link_poses()
    heads = {name: nail.head_pose() for name, nail in world.nails.items()}
    return SceneState(links, world.X_base_tool(), heads, person.center.copy(), person.visible_arm)


def nail_of(body: str) -> str:
    """The nail of which a visual body of `BodyId.NAIL` is a part.

    Args:
        body: Name of the body.

    Returns:
        Name of the nail.
    """
    return body.removeprefix(_HEAD).removeprefix(_SHANK)


class NailVisuals:
    """Head and shank of a nail as meshes.

    Args:
        name: Its name.
        spec: Its sizes.
    """

    def __init__(self, name: str, spec: NailSpec) -> None:
        self._name, self._spec = name, spec
        self._head = cylinder(spec.head_diameter / 2, spec.head_thickness)
        self._shank = cylinder(spec.diameter / 2, spec.length)

    def bodies(self, X: Array) -> list[VisualBody]:
        """The nail with its head's top at X, (4, 4) in `base`; see `nail_of`."""
        spec = self._spec
        head = X @ transform(p=[0.0, 0.0, spec.head_thickness / 2])
        shank = X @ transform(p=[0.0, 0.0, spec.head_thickness + spec.length / 2])
        grey: Color = (0.62, 0.62, 0.66)
        return [
            VisualBody(f"{part}{self._name}", mesh, at, "steel_bright", grey, 0.35, 1.0, body_id=BodyId.NAIL)
            for part, mesh, at in ((_HEAD, self._head, head), (_SHANK, self._shank, shank))
        ]


class SceneVisuals:
    """A `VisualWorld` of the station; meshes are built once.

    Args:
        config: The station.
        tool: The tool.
        seed: Seed of the person's skin and shirt colors.
        state: Returns the current poses.
        boards: Calibration boards in the world.

    Attributes:
        table_height: Height of the table's top over the base plane [m].
    """

    def __init__(
        self,
        config: StationConfig,
        tool: Tool,
        seed: int,
        state: Callable[[], SceneState],
        boards: Sequence[PlacedBoard] = (),
    ) -> None:
        self._state = state
        self._boards = [BoardVisuals(board) for board in boards]
        self._person_height = config.scene.person_size[2]
        rng = np.random.default_rng([seed, 12])
        self._skin = skin_tone(rng)
        self._shirt = SHIRT_COLORS[int(rng.integers(len(SHIRT_COLORS)))]
        self._links = {
            name: (Mesh.build(mesh.vertices, mesh.faces), of_hand)
            for of_hand, meshes in ((False, arm_meshes()), (True, hand_model(config.hand).meshes))
            for name, mesh in meshes.items()
        }
        self._parts = [
            (f"tool_{i}_{part.label}", Mesh.build(part.mesh.vertices, part.mesh.faces), part.material)
            for i, part in enumerate(tool.parts)
        ]
        work = config.work
        self.table_height = config.scene.table_height
        X_base_stand, size = work.stand_box(self.table_height)
        self._static = [
            _static("stand", box(size), X_base_stand, "steel_painted", STAND_COLOR),
            _static("block", box(work.block_size), work.X_base_block, "wood_block", PINE_COLOR),
        ]
        self._static += [
            VisualBody(o.name, box(o.size), o.X_base_box, "steel_painted", OBSTACLE_COLOR, 0.6, body_id=BodyId.WORK)
            for o in config.scene.obstacles
        ]
        self._nails = {name: NailVisuals(name, NailSpec.from_config(of_one)) for name, of_one in work.each()}
        self._head = sphere(0.11)
        self._torso = box(config.scene.person_size)
        self._fist = sphere(0.045)

    def visual_bodies(self) -> Sequence[VisualBody]:
        """The current visual bodies, without the room."""
        state = self._state()
        bodies = list(self._static)
        for name, (mesh, hand) in self._links.items():
            X = state.links.get(name, np.eye(4))  # the base itself does not move
            color: Color = (0.30, 0.30, 0.32) if hand else (0.70, 0.72, 0.75)
            finish = "plastic" if hand else "aluminium"
            bodies.append(
                VisualBody(name, mesh, X, finish, color, 0.5, 0.0 if hand else 0.4,
                           body_id=BodyId.HAND if hand else BodyId.ARM)
            )  # fmt: skip
        for name, mesh, material in self._parts:
            bodies.append(
                VisualBody(name, mesh, state.X_base_tool, material.name, material.color, material.roughness,
                           material.metallic, body_id=BodyId.TOOL)
            )  # fmt: skip
        for board in self._boards:
            bodies.extend(board.bodies(state.links[FLANGE_FRAME]))
        for name, X in state.Xs_base_nail.items():
            bodies.extend(self._nails[name].bodies(X))
        return [*bodies, *self._visible_person(state)]

    def _visible_person(self, state: SceneState) -> list[VisualBody]:
        center = state.person_center
        top = center[2] + self._person_height / 2
        X_head = transform(p=[center[0], center[1], top + 0.10])
        shirt, skin, person_id = self._shirt, self._skin, BodyId.PERSON
        parts = [
            VisualBody("person_torso", self._torso, transform(p=center), "cloth", shirt, 0.9, body_id=person_id),
            VisualBody("person_head", self._head, X_head, "skin", skin, 0.6, body_id=person_id),
        ]
        if state.person_arm is not None:
            shoulder, hand = state.person_arm
            length = float(np.linalg.norm(hand - shoulder))
            arm = cylinder(0.05, length, top_radius=0.04)
            X_fist = transform(p=hand)
            parts.append(VisualBody("person_arm", arm, _along(shoulder, hand), "skin", skin, 0.6, body_id=person_id))
            parts.append(VisualBody("person_fist", self._fist, X_fist, "skin", skin, 0.6, body_id=person_id))
        return parts


def _static(name: str, mesh: Mesh, X: Array, finish: str, color: Color) -> VisualBody:
    return VisualBody(name, mesh, X, finish, color, 0.6, body_id=BodyId.WORK)


def _along(a: Array, b: Array) -> Array:
    """Pose of a cylinder (centred, along z) from a to b."""
    z = b - a
    x = np.array([1.0, 0.0, 0.0]) if abs(z[0]) < 0.9 * np.linalg.norm(z) else np.array([0.0, 1.0, 0.0])
    return frame_from_axes(z=z, x=x, p=(a + b) / 2)
