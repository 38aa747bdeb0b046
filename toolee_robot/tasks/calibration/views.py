"""The board's plate on the flange, the views of it that a calibration needs, and poses of the arm that show them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from toolee_robot.calibration.board import Board
from toolee_robot.control import CollisionWorld, RobotModel
from toolee_robot.control.kinematics import smallest_singular_value
from toolee_robot.errors import UnreachableError, UserError
from toolee_robot.frames import Array, inverse, transform, transform_points
from toolee_robot.station import CameraConfig, HandConfig, StationConfig
from toolee_robot.types import MOUNT, ToolMount

THICKNESS = 0.02
"""Thickness of the box around the plate, screws included [m]."""
PLATE_MARGIN = 0.03
"""By how much the box is larger than the squares, on each side [m]."""
DISTANCE = (0.04, 0.4)
"""Least and largest distance of the printed side from the flange [m]; nearer, the plate would meet the wrist."""
_STIFF = 1000.0
"""Torque at which the plate's holder yields [Nm]: never, but a mount has one."""


@dataclass(frozen=True)
class Plate:
    """A flat plate parallel to the flange, the board's print outwards and centred on the flange's axis.

    That is where the plate is to be in collision checks and plans, to a centimetre or so. The calibration determines
    where it really is.

    Attributes:
        board: The board.
        distance: Distance of the print from the flange's face [m].
        mass: Mass of plate and holder [kg].
    """

    board: Board
    distance: float
    mass: float

    def __post_init__(self) -> None:
        if not DISTANCE[0] <= self.distance <= DISTANCE[1]:
            raise UserError(
                f"a plate {self.distance} m from the flange: give {DISTANCE[0]} to {DISTANCE[1]} m. A nearer "
                "plate meets the wrist"
            )
        if not 0.05 <= self.mass <= 5.0:
            raise UserError(f"a plate of {self.mass} kg: weigh plate and holder")

    @property
    def X_flange_board(self) -> Array:
        """Nominal pose of the board in the flange, (4, 4): its z into the plate, its y against the flange's."""
        R = np.diag([1.0, -1.0, -1.0])
        return transform(R, np.array([0.0, 0.0, self.distance]) - R @ self.board.center)

    def station(self, config: StationConfig) -> StationConfig:
        """Put the plate in the place of a station's hand.

        Args:
            config: The station.

        Returns:
            The station that moves while the camera is calibrated.
        """
        width, height = (length + 2 * PLATE_MARGIN for length in self.board.size)
        middle = self.distance - THICKNESS / 2
        mount = ToolMount(
            position=(0.0, 0.0, middle),
            handle=(1.0, 0.0, 0.0),
            working_side=(0.0, 0.0, 1.0),
            mass=self.mass,
            center_of_mass=(0.0, 0.0, middle),
            clamp_mass=self.mass / 10,
            body_size=(width, height, THICKNESS),
            body_position=(0.0, 0.0, middle),
            hinge_position=(0.0, 0.0, middle),
            hinge_axis=(0.0, 1.0, 0.0),
            stiffness=0.0,
            travel=0.1,
        )
        return replace(config, hand=HandConfig(model=MOUNT, yield_torque=_STIFF, mount=mount))


TILT = (np.deg2rad(20.0), np.deg2rad(40.0))
"""Angle of the board off facing the camera, where it is tilted [rad]."""
TILTED = np.deg2rad(15.0)
"""Angle from which on a view counts as tilted [rad]."""
TURNED = np.deg2rad(25.0)
"""Rotation about the line of sight from which on a view counts as turned [rad]."""
LARGEST_TURN = np.deg2rad(60.0)
"""Rotation about the line of sight that is planned [rad]; any more needs a wrist that no other view needs."""
NEAR, FAR = 0.45, 0.25
"""Width of the board in the image, as a share of its width, from which on a view is near, and up to which it is far."""
MARGIN = 18.0
"""Distance of the board's corners from the image's edge in a planned view [px]: for a camera that is not quite where it
was measured."""
CLEARANCE = 0.02
"""Clearance of the arm and the plate in a planned view [m]."""
_SAMPLES = 3000
_FAR_ENOUGH = 1.1
"""Distance of the board at most, as a multiple of that at which it fills `FAR` of the image."""
_TRAVEL = 2.6
"""Largest turn of a joint from the home posture [rad]."""


KINDS = (
    "left edge nearer", "right edge nearer", "upper edge nearer", "lower edge nearer",
    "turned clockwise", "turned anticlockwise", "near", "far",
    "left in the image", "right in the image", "high in the image", "low in the image",
)  # fmt: skip
"""What the views of a calibration must have between them, as the camera sees the board."""
ENOUGH = 2
"""Views of each kind that a calibration should have."""


def kinds_of(X_camera_board: Array, board: Board, camera: CameraConfig) -> set[str]:
    """Tell what a view contributes.

    Args:
        X_camera_board: Pose of the board, (4, 4).
        board: The board.
        camera: The camera.

    Returns:
        Some of `KINDS`.
    """
    normal, along = X_camera_board[:3, 2], X_camera_board[:3, 0]
    center = transform_points(X_camera_board, board.center[None])[0]
    tilt = np.arcsin(np.clip(normal[:2], -1.0, 1.0))
    turn = float(np.arctan2(along[1], along[0]))
    share = board.size[0] * camera.fx / center[2] / camera.width
    u, v = camera.intrinsics.project(center)
    tests = {
        # The normal points away from the camera: with its x positive the right edge is the nearer one.
        "left edge nearer": tilt[0] < -TILTED, "right edge nearer": tilt[0] > TILTED,
        "upper edge nearer": tilt[1] < -TILTED, "lower edge nearer": tilt[1] > TILTED,
        "turned clockwise": turn > TURNED, "turned anticlockwise": turn < -TURNED,
        "near": share > NEAR, "far": share < FAR,
        "left in the image": u < 0.42 * camera.width, "right in the image": u > 0.58 * camera.width,
        "high in the image": v < 0.42 * camera.height, "low in the image": v > 0.58 * camera.height,
    }  # fmt: skip
    return {name for name, seen in tests.items() if seen}


def missing(Xs_camera_board: Sequence[Array], board: Board, camera: CameraConfig) -> list[str]:
    """Tell which kinds of views are missing.

    Args:
        Xs_camera_board: Poses of the board in the views so far, (4, 4) each.
        board: The board.
        camera: The camera.

    Returns:
        Those of `KINDS` of which there are fewer than `ENOUGH` views.
    """
    counts = dict.fromkeys(KINDS, 0)
    for X in Xs_camera_board:
        for kind in kinds_of(X, board, camera):
            counts[kind] += 1
    return [kind for kind, count in counts.items() if count < ENOUGH]


def plan_views(robot: RobotModel, config: StationConfig, plate: Plate, count: int, seed: int = 0) -> list[Array]:
    """Choose poses of the arm that show the board in different ways, in the order of a short tour.

    The views are planned with the camera where the station file has it. That need not be exact: where the board
    does not come into the image as planned, a view is lost. The tour begins with the view that is the last to be lost,
    that with the board nearest to the middle of the image.

    Args:
        robot: Kinematic model of the arm with the plate.
        config: The station with the plate, from `Plate.station`.
        plate: The plate.
        count: Number of poses.
        seed: Seed of the samples.

    Returns:
        Joint positions, (6,) [rad] each.

    Raises:
        UnreachableError: There are fewer poses that the arm reaches and that are free of collisions.
    """
    rng = np.random.default_rng([seed, 21])
    camera, board = config.camera, plate.board
    Xs_camera_board = np.array([_sample(board, camera, rng) for _ in range(_SAMPLES)])
    Xs_camera_board = Xs_camera_board[[_inside(X, board, camera) for X in Xs_camera_board]]
    home = np.array(config.scene.home)
    q = robot.ik.branches(camera.X_base_camera @ Xs_camera_board @ inverse(plate.X_flange_board))
    row, branch = np.nonzero(np.all(np.isfinite(q), axis=-1))
    q = robot.ik.unwrap(q[row, branch], home)
    good = np.all((q > robot.arm.lower + 0.1) & (q < robot.arm.upper - 0.1), axis=-1)
    good &= smallest_singular_value(robot.arm.fk_jacobian(q)[1]) > 0.03
    good &= np.max(np.abs(q - home), axis=-1) < _TRAVEL
    q, row = q[good], row[good]
    world = CollisionWorld(robot, config, robot.description.hand_open)
    chosen = _choose(Xs_camera_board[row], row, q, world, home, board, camera, count)
    if len(chosen) < count:
        raise UnreachableError(
            f"the arm reaches only {len(chosen)} of {count} views of the board. If the camera stands elsewhere, "
            "correct camera.position and camera.target. Otherwise move the camera or the obstacle, ask for fewer "
            "views, or use a smaller board"
        )
    middle = np.array([camera.width, camera.height]) / 2
    centers = camera.intrinsics.project((Xs_camera_board[row[chosen]] @ [*board.center, 1.0])[:, :3])
    first = chosen[int(np.argmin(np.linalg.norm(centers - middle, axis=1)))]
    return [q[first], *_tour([q[i] for i in chosen if i != first], q[first])]


def _sample(board: Board, camera: CameraConfig, rng: np.random.Generator) -> Array:
    nearest = board.size[0] * camera.fx / (0.62 * camera.width)
    farthest = _FAR_ENOUGH * board.size[0] * camera.fx / (FAR * camera.width)
    depth = rng.uniform(nearest, farthest)
    u, v = rng.uniform(0.15, 0.85) * camera.width, rng.uniform(0.15, 0.85) * camera.height
    center = depth * camera.intrinsics.rays(np.array([u, v]))
    direction, tilt = rng.uniform(0, 2 * np.pi), rng.uniform(*TILT)
    turn = rng.uniform(-LARGEST_TURN, LARGEST_TURN)
    R = Rotation.from_rotvec(tilt * np.array([np.cos(direction), np.sin(direction), 0.0]))
    R *= Rotation.from_rotvec([0.0, 0.0, turn])
    return transform(R, center - R.as_matrix() @ board.center)


def _inside(X_camera_board: Array, board: Board, camera: CameraConfig) -> bool:
    width, height = board.size
    p = transform_points(X_camera_board, np.array([[0, 0, 0], [width, 0, 0], [width, height, 0], [0, height, 0.0]]))
    u, v = camera.intrinsics.project(p).T
    return bool(
        np.all((u > MARGIN) & (u < camera.width - MARGIN) & (v > MARGIN) & (v < camera.height - MARGIN))
        and np.all(p[:, 2] > 0.2)
    )


def _choose(
    Xs_camera_board: Array, sample: NDArray[np.intp], q: Array, world: CollisionWorld, home: Array, board: Board,
    camera: CameraConfig, count: int,
) -> list[int]:  # fmt: skip
    """Greedy: the kinds that are missing first, then the orientations that are farthest from those chosen."""
    kinds = [kinds_of(X, board, camera) for X in Xs_camera_board]
    orientations = Rotation.from_matrix(Xs_camera_board[:, :3, :3])
    travel = np.max(np.abs(q - home), axis=-1) if len(q) else np.zeros(0)
    seen = dict.fromkeys(KINDS, 0)
    apart = np.full(len(q), np.pi)
    left = np.ones(len(q), dtype=bool)
    chosen: list[int] = []
    while len(chosen) < count and left.any():
        wanted = np.array([sum(seen[kind] < ENOUGH for kind in have) for have in kinds])
        value = np.where(left, wanted + np.minimum(apart, 0.6) - 0.3 * travel, -np.inf)
        best = int(np.argmax(value))
        left[best] = False
        if not world.inside(q[best][None]) or world.closest(q[best], 2 * CLEARANCE).distance < CLEARANCE:
            continue
        left &= sample != sample[best]
        chosen.append(best)
        for kind in kinds[best]:
            seen[kind] += 1
        apart = np.minimum(apart, (orientations[best].inv() * orientations).magnitude())
    return chosen


def _tour(poses: list[Array], start: Array) -> list[Array]:
    """Order poses by nearest neighbour."""
    left, tour, here = list(poses), [], start
    while left:
        nearest = min(range(len(left)), key=lambda i: float(np.max(np.abs(left[i] - here))))
        here = left.pop(nearest)
        tour.append(here)
    return tour
