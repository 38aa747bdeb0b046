"""The place of a nail and the plane of the wood: by touches with a known tip, and by a board on the wood."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from toolee_robot.calibration.board import Board
from toolee_robot.calibration.observation import find_board
from toolee_robot.calibration.touches import KnownCamera, see_board
from toolee_robot.errors import UserError
from toolee_robot.frames import Array, angle_between, transform_points

MIN_TOUCHES = 3
"""Fewest touches, of the nail's head or of the wood; a fourth of the wood tells whether all lie on one plane."""
MIN_WIDTH = 0.030
"""Least width of the touched places across the line that they come nearest to [m]: touches that are 0.2 mm off, as
assumed, then tell the tilt across it to half a degree."""
AGREES = 0.999
"""Probability with which touches of the wood lie as near to its plane, and touches and sight of a nail agree as well,
as their deviations explain."""


@dataclass(frozen=True, eq=False)
class WoodPlane:
    """The plane of the wood's top.

    Attributes:
        point: A point of it, (3,) [m], `base`.
        rise: How it rises along x and y of `base`, (2,) [m per m].
        covariance: Covariance of the height at `point` and of the rise, (3, 3) [m, m per m].
        residuals: Heights of the touches over the plane, (N,) [m].
    """

    point: Array
    rise: Array
    covariance: Array
    residuals: Array

    @property
    def normal(self) -> Array:
        """Normal of the plane, out of the wood, `base`, (3,)."""
        v = np.array([-self.rise[0], -self.rise[1], 1.0])
        return np.asarray(v / np.linalg.norm(v))

    @property
    def tilt(self) -> float:
        """Angle of the normal to z of `base` [rad]."""
        return angle_between(self.normal, np.array([0.0, 0.0, 1.0]))

    @property
    def tilt_sigma(self) -> float:
        """Standard deviation of the rise about its least known direction [rad]."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[1:, 1:])[-1]))


def fit_wood(p: Array, at: Array, *, repeat: float, common: float) -> WoodPlane:
    """Fit the plane of the wood to touches, by least squares of their heights.

    Args:
        p: The tip at the touches, (N, 3) [m], `base`.
        at: Where the plane's height is wanted, x and y of `base`, (2,) [m].
        repeat: Standard deviation of a touch about each axis, by what differs from one touch to the next [m].
        common: Standard deviation of their height by what is the same in all: tip and kinematics [m].

    Returns:
        The plane.

    Raises:
        UserError: There are too few touches, they lie nearly on a line or too near to each
            other, or not on a plane.
    """
    if len(p) < MIN_TOUCHES:
        raise UserError(f"{len(p)} touches of the wood: give {MIN_TOUCHES} or more; a fourth reveals a wrong one")
    _check_spread(p[:, :2])
    A = np.column_stack([np.ones(len(p)), p[:, :2] - at])
    (height, *rise), *_ = np.linalg.lstsq(A, p[:, 2], rcond=None)
    residuals = p[:, 2] - A @ np.array([height, *rise])
    slope = np.array(rise)
    # A touch that is off sideways is off the plane by as much times its rise.
    variance = repeat**2 * (1.0 + float(slope @ slope))
    information = A.T @ A
    _check_flat(A, residuals, np.sqrt(variance))
    covariance = variance * np.linalg.inv(information) + np.diag([common**2, 0.0, 0.0])
    return WoodPlane(np.array([*at, height]), slope, covariance, residuals)


def _check_spread(xy: Array) -> None:
    """Refuse places, (N, 2) [m], that are too near to a line."""
    widths = []
    for i, j in combinations(range(len(xy)), 2):
        along = xy[j] - xy[i]
        if (length := float(np.linalg.norm(along))) > 1e-9:
            widths.append(float(np.ptp((xy - xy[i]) @ np.array([-along[1], along[0]]) / length)))
    width = min(widths, default=0.0)
    if width >= MIN_WIDTH:
        return
    longest = max(float(np.linalg.norm(a - b)) for a, b in combinations(xy, 2))
    where = "nearly on a line" if width < 0.5 * longest else "too near to each other"
    raise UserError(
        f"the touches of the wood lie {where}: up to {longest * 1e3:.0f} mm apart, but only {width * 1e3:.0f} mm wide "
        f"across that. {MIN_WIDTH * 1e3:.0f} mm are needed. Touch once more, "
        f"{(MIN_WIDTH - width) * 1e3:.0f} mm further out across the line"
    )


def _check_flat(A: Array, residuals: Array, sigma: float) -> None:
    """Refuse touches whose distances from the plane their standard deviation [m] does not explain."""
    spare = len(A) - A.shape[1]
    if spare == 0 or residuals @ residuals <= sigma**2 * chi2.ppf(AGREES, spare):
        return
    # Distance of each touch from the plane of the others: the leverage tells it without another fit.
    leverage = np.einsum("ij,jk,ik->i", A, np.linalg.inv(A.T @ A), A)
    off = residuals / np.maximum(1.0 - leverage, 1e-9)
    more = f"more than touches of ±{sigma * 1e3:.1f} mm (--repeat-mm) explain"
    warped = "if it stays so the wood is warped: plane it, or take another block"
    if spare == 1:  # each of them as likely as the others
        least, most = np.min(np.abs(off)) * 1e3, np.max(np.abs(off)) * 1e3
        raise UserError(
            f"the four touches of the wood are not on a plane: each is {least:.1f} to {most:.1f} mm off that of the "
            f"others, {more}. One met something else. Touch once more to find it; {warped}"
        )
    # The most unlikely one, by how well the plane of the others is known at its place.
    worst = int(np.argmax(np.abs(residuals) / np.sqrt(np.maximum(1.0 - leverage, 1e-9))))
    side = "above" if off[worst] > 0 else "below"
    raise UserError(
        f"touch {worst + 1} of the wood is {abs(off[worst]) * 1e3:.1f} mm {side} the plane of the others, {more}: "
        f"touch there again; {warped}"
    )


LARGEST_SPREAD = 2e-3
"""Distance of a touch from the median of all above which it was on something else [m]."""
LARGEST_TILT = float(np.deg2rad(5.0))
"""Tilt of a board beyond which it does not lie on the wood [rad]: a block on its stand is straighter."""
LARGEST_SCALING = 0.03
"""Deviation of the board's distance in the depth image from that by its size beyond which its size is wrong."""
FEWEST_DEPTHS = 30
"""Fewest pixels of the board with a depth for that comparison."""


@dataclass(frozen=True, eq=False)
class LocatedNail:
    """A nail's head.

    Attributes:
        head: Middle of its top in `base`, (3,) [m].
        spread: Largest distance of a touch from it [m].
        covariance: Covariance of `head`, (3, 3) [m^2].
    """

    head: Array
    spread: float
    covariance: Array


@dataclass(frozen=True)
class OnWood:
    """How a board lies on the wood, with the standard deviations of a person's measurement.

    Attributes:
        p_board_nail: Place of the nail's axis in the board's frame, x and y [m].
        thickness: Height of the printed plane over the wood [m].
        placing_error: Standard deviation of the nail's place on the board about each axis [m].
        thickness_error: Standard deviation of the height [m].
    """

    p_board_nail: tuple[float, float]
    thickness: float
    placing_error: float = 5e-4
    thickness_error: float = 1e-4


@dataclass(frozen=True, eq=False)
class SeenNail:
    """Where a nail enters the wood, by the camera.

    Attributes:
        entry: The nail's axis in the plane of the wood, in `base`, (3,) [m].
        covariance: Its covariance by calibration, image, and how the board lies, (3, 3) [m^2].
        up: The wood's normal, away from it, (3,), `base`.
        tilt: Its angle to the vertical [rad].
        tilt_sigma: Standard deviation of each of the two components of the tilt [rad].
        corners: Number of the board's corners that were seen.
        reprojection: Root mean square reprojection error of these [px].
    """

    entry: Array
    covariance: Array
    up: Array
    tilt: float
    tilt_sigma: float
    corners: int
    reprojection: float


def locate_nail(Xs_base_flange: Sequence[Array], p_flange_tip: Array, touch_error: float = 5e-4) -> LocatedNail:
    """Locate the head: the median of the touches.

    Args:
        Xs_base_flange: Poses of the flange with the tip on the head's middle, (4, 4) each.
        p_flange_tip: The tip in the flange, (3,) [m].
        touch_error: Standard deviation of the mean of the touches about each axis [m]: tip, kinematics and eye, which
            are off by much the same each time.

    Returns:
        The nail.

    Raises:
        UserError: There are too few touches, or they disagree.
    """
    if len(Xs_base_flange) < MIN_TOUCHES:
        raise UserError(f"{len(Xs_base_flange)} touches: give {MIN_TOUCHES} or more")
    p = transform_points(np.asarray(Xs_base_flange), p_flange_tip[None])[:, 0]
    head = np.median(p, axis=0)
    off = np.linalg.norm(p - head, axis=1)
    if off.max() > LARGEST_SPREAD:
        raise UserError(
            f"touch {int(np.argmax(off)) + 1} is {off.max() * 1e3:.1f} mm from the others: touch the middle of the "
            "head again, and check the tip with `toolee calibrate mount`"
        )
    covariance = np.diag(touch_error**2 + p.var(axis=0, ddof=1) / len(p))
    return LocatedNail(head, float(off.max()), covariance)


def see_nail(
    camera: KnownCamera,
    board: Board,
    on_wood: OnWood,
    rgb: NDArray[np.uint8],
    depth: NDArray[np.float32] | None = None,
) -> SeenNail:
    """Locate the nail by an image of a board on the wood.

    Args:
        camera: The calibrated camera.
        board: The board with its measured square.
        on_wood: How it lies.
        rgb: The image, (H, W, 3) uint8, or grey.
        depth: The depth image, registered to it, (H, W) [m], 0 or NaN where unknown; None where there is none: a wrong
            size of the board is then not noticed.

    Returns:
        The nail.

    Raises:
        UserError: The board is not seen, or so that its tilt is ambiguous; it has another size, or lies on
            no upright block's top.
    """
    view = find_board(rgb, board)
    if view is None:
        raise UserError(
            "no board is seen in the image. Check --sheet, and that the board is whole, flat, well lit and near"
        )
    seen = see_board(camera, board, view, rgb)
    if depth is not None:
        _check_size(seen.X_camera_board, board, camera, depth)
    X = seen.X_base_board
    up = -X[:3, 2]
    tilt = angle_between(up, np.array([0.0, 0.0, 1.0]))
    if tilt > LARGEST_TILT:
        raise UserError(
            f"the board is tilted by {np.rad2deg(tilt):.1f}°, and {np.rad2deg(LARGEST_TILT):.0f} are allowed. Lay "
            "it flat on the wood, level the wood, or check the camera's calibration (`toolee calibrate check`)"
        )
    p_board = np.array([*on_wood.p_board_nail, on_wood.thickness])
    entry, covariance = seen.point(p_board)
    by_person = np.diag([on_wood.placing_error, on_wood.placing_error, on_wood.thickness_error]) ** 2
    covariance = covariance + X[:3, :3] @ by_person @ X[:3, :3].T
    tilt_sigma = float(np.sqrt(np.trace(seen.rotation()[:2, :2]) / 2))
    return SeenNail(entry, covariance, up, tilt, tilt_sigma, len(view.ids), seen.reprojection)


def _check_size(X_camera_board: Array, board: Board, camera: KnownCamera, depth: NDArray[np.float32]) -> None:
    """Compare the distance of the board by its size with that in the depth image."""
    k = camera.intrinsics
    width, height = board.size
    x, y = np.meshgrid(np.linspace(0.02, 0.98, 40) * width, np.linspace(0.02, 0.98, 40) * height)
    points = transform_points(X_camera_board, np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]))
    u, v = np.rint(k.project(points)).astype(int).T
    inside = (u >= 0) & (u < k.width) & (v >= 0) & (v < k.height)
    measured = depth[v[inside], u[inside]]
    known = np.isfinite(measured) & (measured > 0.0)
    if np.count_nonzero(known) < FEWEST_DEPTHS:
        return
    ratio = float(np.median(measured[known] / points[inside, 2][known]))
    if abs(ratio - 1.0) > LARGEST_SCALING:
        raise UserError(
            f"by its size the board is {points[:, 2].mean():.3f} m away, by the depth image {ratio:.3f} times as "
            f"far. Its squares seem to be {ratio * board.square * 1e3:.1f} mm, not {board.square * 1e3:.1f}. Check "
            "--sheet, and measure both scale bars again"
        )


def foot_of(head: Array, up: Array, protrusion: float, lean: tuple[float, float] = (0.0, 0.0)) -> Array:
    """Follow a nail from its head to the wood.

    Args:
        head: Middle of its head's top, (3,) [m], `base`.
        up: Normal of the wood, out of it, (3,), `base`.
        protrusion: Height of the head over the wood along the nail [m].
        lean: How it leans from the normal, as `work.nail_lean`.

    Returns:
        Where its axis meets the wood, (3,) [m], `base`.
    """
    axis = up / up[2] + np.array([*lean, 0.0])
    return np.asarray(head - protrusion * axis / np.linalg.norm(axis))


def check_height(
    head: Array, foot: Array, wood_height: float, protrusion: float, sigma: float, protrusion_error: float = 5e-4
) -> None:
    """Compare touches of a nail's head with touches of the wood, by the same tip.

    Args:
        head: Middle of the head's top, (3,) [m], `base`.
        foot: Where the nail meets the wood by it and by the nail's height, (3,) [m].
        wood_height: Height of the wood there by its touches [m].
        protrusion: That height of the nail [m].
        sigma: Standard deviation of the two heights' difference, by the touches [m].
        protrusion_error: Standard deviation of the nail's height [m].

    Raises:
        UserError: The two disagree.
    """
    off = wood_height - foot[2]
    if off**2 > (sigma**2 + protrusion_error**2) * chi2.ppf(AGREES, 1):
        raise UserError(
            f"by touch the nail stands {(head[2] - wood_height) * 1e3:.1f} mm over the wood, but "
            f"work.nail_protrusion says {protrusion * 1e3:.1f}. Measure it again, and repeat touches that missed "
            "the middle of the head or the wood"
        )


def combine(
    seen: SeenNail,
    touched: LocatedNail,
    protrusion: float,
    protrusion_error: float = 5e-4,
    lean: tuple[float, float] = (0.0, 0.0),
) -> SeenNail:
    """Combine sight and touches of a nail, weighted by their covariances.

    Args:
        seen: The nail by the camera.
        touched: Its head by touches.
        protrusion: Height of the head over the wood [m].
        protrusion_error: Standard deviation of it [m].
        lean: How the nail leans from the wood's normal, as `work.nail_lean`.

    Returns:
        The nail.

    Raises:
        UserError: The two disagree by more than their covariances explain.
    """
    entry = foot_of(touched.head, seen.up, protrusion, lean)
    covariance = touched.covariance + protrusion_error**2 * np.outer(seen.up, seen.up)
    off, both = entry - seen.entry, covariance + seen.covariance
    if off @ np.linalg.solve(both, off) > chi2.ppf(AGREES, 3):
        raise UserError(
            f"camera and touches disagree by ({off[0] * 1e3:+.1f}, {off[1] * 1e3:+.1f}, {off[2] * 1e3:+.1f}) mm, "
            "more than their errors explain. Check the tip (`toolee calibrate mount`), the nail's position on the "
            "board, the board's height above the wood, and the camera (`toolee calibrate check`)"
        )
    gain = seen.covariance @ np.linalg.inv(both)
    return SeenNail(
        seen.entry + gain @ off, seen.covariance - gain @ seen.covariance, seen.up, seen.tilt, seen.tilt_sigma,
        seen.corners, seen.reprojection,
    )  # fmt: skip
