"""From the clicks on a frame to end effectors with pose, covariance, box and checks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from toolee_robot.end_effectors import Category
from toolee_robot.errors import UserError
from toolee_robot.frames import Array
from toolee_robot.perception.offline.annotation.clicks import PROTOCOL, ClickedEnd, Role, Shape
from toolee_robot.perception.offline.annotation.fit import Fit, fit
from toolee_robot.perception.offline.annotation.measurements import CALIPER, STEP, Measurements, measure
from toolee_robot.perception.offline.annotation.models import AxisModel, PlaneModel
from toolee_robot.symmetry import SymmetryKind
from toolee_robot.types import RgbdFrame

TAPE = 2.0
"""Standard deviation of a tape-measured distance [mm]."""
LIMIT = 3.0
"""A check fails where it differs by more than so many standard deviations."""

Box = tuple[float, float, float, float]


@dataclass(frozen=True)
class Check:
    """What a person measured beside what the clicks say without it.

    Attributes:
        name: What was measured.
        measured_mm: By caliper or tape [mm].
        fitted_mm: By the other clicks [mm].
        sigma_mm: Standard deviation of the difference [mm]; infinite where the clicks do not tell it.
    """

    name: str
    measured_mm: float
    fitted_mm: float
    sigma_mm: float

    @property
    def agrees(self) -> bool:
        """Whether both are the same within LIMIT standard deviations."""
        return abs(self.measured_mm - self.fitted_mm) <= LIMIT * self.sigma_mm


@dataclass(frozen=True, eq=False)
class AnnotatedEnd:
    """An end effector as the clicks tell it.

    Attributes:
        clicked: The clicks.
        category: Its category.
        fit: Pose, covariance and residuals.
        box: Box of what is seen of it [px], x0, y0, x1, y1.
        checks: Comparisons with what the person measured.
        circle: The fitted rim, (N, 3) [m]; None where there is none.
    """

    clicked: ClickedEnd
    category: Category
    fit: Fit
    box: Box
    checks: tuple[Check, ...]
    circle: Array | None

    @property
    def known(self) -> bool:
        """Whether every check agrees; a pose that contradicts a measurement is not used."""
        return all(check.agrees for check in self.checks)

    @property
    def sigma_mm(self) -> float:
        """Root mean square of the position's error that is to be expected [mm]."""
        return 1000.0 * position_sigma(self.fit.covariance)

    @property
    def sigma_deg(self) -> float:
        """Root mean square of the rotation's error that is to be expected, modulo the category's symmetry [deg]."""
        return float(np.rad2deg(rotation_sigma(self.category, self.fit.X_camera_ee, self.fit.covariance)))


def position_sigma(covariance: Array) -> float:
    """Root mean square of the position's error [m] by a pose's covariance, 6x6."""
    return float(np.sqrt(np.trace(covariance[:3, :3])))


def rotation_sigma(category: Category, X_camera_ee: Array, covariance: Array) -> float:
    """Root mean square of the rotation's error modulo a category's symmetry.

    Args:
        category: The category.
        X_camera_ee: The pose, 4x4.
        covariance: Its covariance, 6x6, in the camera's axes.

    Returns:
        The angle [rad].
    """
    group, turns = category.symmetry, covariance[3:, 3:]
    if group.kind is not SymmetryKind.CINF:
        return float(np.sqrt(np.trace(turns)))
    axis = X_camera_ee[:3, :3] @ np.asarray(group.axis)
    return float(np.sqrt(max(np.trace(turns) - axis @ turns @ axis, 0.0)))


def annotate_end(frame: RgbdFrame, clicked: ClickedEnd, tape_offset_mm: float | None) -> AnnotatedEnd:
    """The pose of a clicked end effector.

    Args:
        frame: The frame.
        clicked: The clicks.
        tape_offset_mm: Distance of the depth's origin behind the tape's beginning, along the optical axis [mm]; needed
            where a distance was measured by tape.

    Returns:
        The end effector.

    Raises:
        UserError: Clicks are missing, have no depth, do not determine the pose or contradict each other; or the tape's
            beginning is not known.
    """
    measured = measure(frame, clicked)
    checks = []
    if clicked.shape is Shape.FACE and measured.caliper is not None:
        # First without the caliper's reading, which is then compared with what the clicks say of themselves.
        free = PlaneModel(Shape.FACE, replace(measured, caliper=None))
        diameter, sigma = free.diameter(fit(free))
        both = float(np.hypot(sigma, CALIPER))
        check = Check(PROTOCOL[Shape.FACE].caliper, *(1000.0 * v for v in (measured.caliper, diameter, both)))
        checks.append(check)
        measured = measured if check.agrees else replace(measured, caliper=None)
    model = AxisModel(measured) if clicked.shape is Shape.TIP else PlaneModel(clicked.shape, measured)
    found = fit(model)
    if clicked.tape_mm is not None:
        checks.append(_tape(found, clicked.tape_mm, tape_offset_mm))
    circle = model.circle(found.parameters) if isinstance(model, PlaneModel) else None
    box = clicked_box(clicked) or _connected_box(frame, clicked, measured, found.X_camera_ee)
    return AnnotatedEnd(clicked, clicked.shape.category, found, box, tuple(checks), circle)


def _tape(found: Fit, tape_mm: float, offset_mm: float | None) -> Check:
    if offset_mm is None:
        raise UserError(
            "a distance was measured by tape, but the start of the tape is missing. Enter how far the depth's "
            "origin lies behind it (the camera's data sheet; 0 if the tape begins at the origin)",
            code="user.tape_offset_missing",
        )
    line = 1000.0 * found.X_camera_ee[:3, 3] - np.array([0.0, 0.0, offset_mm])
    fitted = float(np.linalg.norm(line))
    variance = 1e6 * float(line @ found.covariance[:3, :3] @ line) / fitted**2
    return Check("distance by tape", tape_mm, fitted, float(np.sqrt(TAPE**2 + variance)))


def clicked_box(clicked: ClickedEnd) -> Box | None:
    """The box by two clicked corners [px].

    Args:
        clicked: The clicks.

    Returns:
        x0, y0, x1, y1; None where no corner is clicked.

    Raises:
        UserError: There is one corner, or more than two.
    """
    corners = clicked.of(Role.BOX)
    if len(corners) == 1 or len(corners) > 2:
        raise UserError(
            f"{len(corners)} clicks on the box's corners: give two opposite ones", code="user.clicks_missing"
        )
    if not corners:
        return None
    (u0, u1), (v0, v1) = sorted(c.u for c in corners), sorted(c.v for c in corners)
    return u0, v0, u1, v1


def _connected_box(frame: RgbdFrame, clicked: ClickedEnd, measured: Measurements, X_camera_ee: Array) -> Box:
    """Box about the depth that is connected with the clicks, within the EE's sphere."""
    height, width = frame.depth.shape
    v, u = np.indices((height, width))
    points = measured.rays(np.stack([u, v], -1).astype(np.float64)) * frame.depth[..., None]
    inside = np.linalg.norm(points - X_camera_ee[:3, 3], axis=2) < clicked.shape.category.spec.radius
    depth = np.where(inside, frame.depth, 100.0).astype(np.float32)
    mask = np.zeros((height + 2, width + 2), np.uint8)
    own = [m for m in measured.clicks if m.role is not Role.HANDLE]
    for m in own:
        x, y = round(m.pixel[0]), round(m.pixel[1])
        if 0 <= x < width and 0 <= y < height and inside[y, x]:
            flags = 4 | cv2.FLOODFILL_MASK_ONLY | (255 << 8)
            cv2.floodFill(depth, mask, (x, y), 0.0, STEP, STEP, flags)
    rows, columns = np.nonzero(mask[1:-1, 1:-1])
    shaft = {Role.SHAFT}
    at = np.stack([m.pixel for m in own if m.role not in shaft])
    us, vs = np.concatenate([columns, at[:, 0]]), np.concatenate([rows, at[:, 1]])
    return float(us.min()), float(vs.min()), float(us.max() + 1), float(vs.max() + 1)
