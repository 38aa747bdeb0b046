"""The paper's estimator: pose vectors, and the plain mean of K = 20 samples by RK45.

The sampler is Dormand and Prince's Runge-Kutta 5(4) with an adaptive step, on the device, in batches. Each cloud has
its own step size, so that a result does not depend on the rest of the batch (the published code passes the whole batch
to one solver).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.errors import AssetError, TooleeError, UserError
from toolee_robot.frames import Array, transform
from toolee_robot.perception import weight_files
from toolee_robot.perception.pose.canonical import CanonicalCloud
from toolee_robot.perception.pose.cloud_estimator import CloudEstimator, PoseResult
from toolee_robot.perception.pose.pooling import FREE_SPIN_VARIANCE, align, with_spin_variance
from toolee_robot.perception.pose.processes import Field, Process, Sampler, VarianceExploding
from toolee_robot.perception.pose.representation import twist_angles
from toolee_robot.perception.pose.tooleenet.network import ORDERED, POINTS, PaperNet
from toolee_robot.perception.precision import torch_device
from toolee_robot.symmetry import SymmetryGroup, SymmetryKind
from toolee_robot.types import PoseHypotheses


def class_ambiguity() -> Tensor:
    """S (4, 3) of each category: a constant of the class, 1 about the axis of its symmetry group."""
    rows = [
        [0.0, 0.0, 0.0] if c.symmetry.kind is SymmetryKind.NONE else [float(a != 0) for a in c.symmetry.axis]
        for c in Category
    ]
    return torch.tensor(rows)


def encode(R: Tensor, p: Tensor, ambiguous: Tensor | None) -> Tensor:
    """Encode poses as vectors: the first two columns of the rotation, the ambiguity, the translation.

    Args:
        R: Rotations, (..., 3, 3).
        p: Translations from the mean of the network's points, (..., 3) [m]: the paper centres the pose, not the input.
        ambiguous: Ambiguity vectors S, (..., 3); None: without.

    Returns:
        Pose vectors u, (..., 12); (..., 9) without S.
    """
    parts = [R[..., :, 0], R[..., :, 1], p] if ambiguous is None else [R[..., :, 0], R[..., :, 1], ambiguous, p]
    return torch.cat(parts, dim=-1)


def decode(u: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """R (..., 3, 3) by Gram-Schmidt with x first, p (..., 3) [m] and S (..., 3), zero for u (..., 9)."""
    x = _unit(u[..., 0:3])
    b = u[..., 3:6]
    y = _unit(b - (b * x).sum(-1, keepdim=True) * x)
    R = torch.stack([x, y, torch.cross(x, y, dim=-1)], dim=-1)
    S = u[..., 6:9] if u.shape[-1] == 12 else torch.zeros_like(u[..., 6:9])
    return R, u[..., -3:], S


def _unit(v: Tensor) -> Tensor:
    return v / v.norm(dim=-1, keepdim=True).clamp_min(1e-8)


def mean_pose(Xs: Array, group: SymmetryGroup | None = None) -> Array:
    """Mean of poses.

    The largest eigenvector of the quaternions' second moments (Markley et al., 2007) and the arithmetic mean of the
    positions.

    Args:
        Xs: Poses (K, 4, 4).
        group: A known symmetry, modulo which the rotations are first aligned to the first one.

    Returns:
        The mean, 4x4.
    """
    R = Xs[:, :3, :3]
    if group is not None:
        R = align(R, R[0], group)
    q = Rotation.from_matrix(R).as_quat()
    vectors = np.linalg.eigh(q.T @ q)[1]
    return transform(Rotation.from_quat(vectors[:, -1]), Xs[:, :3, 3].mean(0))


_C = (0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0, 1.0)
_A = (
    (1 / 5,),
    (3 / 40, 9 / 40),
    (44 / 45, -56 / 15, 32 / 9),
    (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
    (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
    (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
)
_E = (-71 / 57600, 0.0, 71 / 16695, -71 / 1920, 17253 / 339200, -22 / 525, 1 / 40)


@dataclass(frozen=True)
class Rk45:
    """Adaptive sampler; see `flow.Sampler`.

    Attributes:
        rtol: Relative tolerance of each step.
        atol: Absolute tolerance of each step.
    """

    rtol: float = 1e-5
    atol: float = 1e-5

    def __call__(self, process: Process, field: Field, noise: Tensor) -> Tensor:
        """Solve the process's equation from noise to data."""
        K = noise.shape[1]

        def derivative(t: Tensor, u: Tensor) -> Tensor:
            each = t[:, None].expand(-1, K)
            v = process.velocity(field, u.to(noise.dtype), each.to(noise.dtype)).double()
            return v * process.rate(t)[:, None, None]

        u = solve(derivative, process.prior(noise).double(), process.start, process.end, self.rtol, self.atol)
        return process.finish(field, u.to(noise.dtype))


def solve(
    derivative: Callable[[Tensor, Tensor], Tensor],
    y: Tensor,
    start: float,
    end: float,
    rtol: float = 1e-5,
    atol: float = 1e-5,
    most_steps: int = 2000,
) -> Tensor:
    """Solve dy/dt = derivative(t, y), with a step size for each row.

    Args:
        derivative: From t (B,) and y (B, ...) to dy/dt (B, ...).
        y: Initial values at t = start, (B, ...).
        start: Initial time.
        end: Final time.
        rtol: Relative tolerance of each step.
        atol: Absolute tolerance of each step.
        most_steps: Largest number of steps.

    Returns:
        y at t = end, (B, ...).

    Raises:
        TooleeError: The steps do not reach the end.
    """
    wide = (-1, *[1] * (y.dim() - 1))
    t = torch.full((len(y),), start, device=y.device, dtype=y.dtype)
    h = torch.full_like(t, 0.01 * (end - start))
    least = 1e-7 * abs(end - start)
    k0 = derivative(t, y)
    for _ in range(most_steps):
        left = end - t
        if not bool((left != 0).any()):
            return y
        h = torch.where(h.abs() >= left.abs(), left, h)
        ks = [k0]
        for c, row in zip(_C[1:], _A, strict=True):
            step = sum((a * k for a, k in zip(row, ks, strict=True)), torch.zeros_like(y))
            ahead = y + h.view(wide) * step
            ks.append(derivative(t + c * h, ahead))
        error = h.view(wide) * sum((e * k for e, k in zip(_E, ks, strict=True)), torch.zeros_like(y))
        scale = atol + rtol * torch.maximum(y.abs(), ahead.abs())
        norm = (error / scale).square().flatten(1).mean(1).sqrt()
        accepted = ((norm <= 1) | (h.abs() <= least)) & (left != 0)
        t = torch.where(accepted, torch.where(h == left, torch.full_like(t, end), t + h), t)
        y = torch.where(accepted.view(wide), ahead, y)
        k0 = torch.where(accepted.view(wide), ks[-1], k0)
        factor = (0.9 * norm.clamp_min(1e-10) ** -0.2).clamp(0.2, 10.0)
        h = h * torch.where(accepted, factor, factor.clamp_max(1.0))
    raise TooleeError(
        f"RK45 needed over {most_steps} steps: the network's field is not smooth, train it longer",
        code="toolee.stiff_ode",
    )


NAME = "pose_paper"
HOW_TO_TRAIN = """\
  toolee dataset generate --config hard --sensor mixed --size 12000 --seed 41 --test-share 0 --out data/paper-arm
  toolee train clouds data/paper-arm/train --true-masks --out runs/paper-arm.npz
  toolee train paper runs/paper-arm.npz --minutes 30 --out runs/paper-arm"""
"""How the paper's estimator is trained for a job. `hard` images, because a job's camera has a sensor's errors. The
shipped weights learnt other views."""
SHIPPED = weight_files.WEIGHTS_DIR / "tooleenet"
"""Folder of the shipped weights of the paper's estimator."""
OBJECT_RADIUS = 0.22
"""Radius [m] of the sphere around a whole tool's middle."""
PROCESS = VarianceExploding()


@dataclass(frozen=True)
class Column:
    """One column of the paper's Table I.

    Attributes:
        name: Name of the column in options and files.
        of_tool: Whether the network estimates the tool's pose, from which the EE's follows by the category's mean
            X_tool_ee.
        predicts_ambiguity: Whether S is part of the pose vector.
        knows_symmetry: Whether the category's group is used when the samples are pooled.
    """

    name: str
    of_tool: bool = False
    predicts_ambiguity: bool = False
    knows_symmetry: bool = False

    @property
    def dim(self) -> int:
        """Length of the pose vector."""
        return 12 if self.predicts_ambiguity else 9


COLUMNS = {
    column.name: column
    for column in (
        Column("object-prior", of_tool=True),
        Column("ee"),
        Column("ee-symmetry-prior", knows_symmetry=True),
        Column("symmetry-aware", predicts_ambiguity=True),
    )
}
"""The columns by name."""


class PaperEstimator(CloudEstimator):
    """The paper's estimator on one device. It has no confidence: every pose is usable.

    A pose's covariance is the scatter of its samples about their mean. Where the symmetry label says that the axis is
    one of symmetry, the spin about it counts as unobserved, whatever the samples' is, and the hand may fix it.

    Args:
        net: The trained network.
        column: The column of Table I.
        device: torch device.
        sampler: Solver of the generative process; None: the paper's RK45.

    Attributes:
        column: As given.
    """

    points, ordered, candidates = POINTS, ORDERED, 20
    uses_completed = False

    def __init__(
        self,
        net: PaperNet,
        column: Column,
        device: str = "cpu",
        sampler: Sampler | None = None,
    ) -> None:
        self._device = torch_device(device)
        self._net = net.to(self._device).eval()
        self.column, self.of_tool = column, column.of_tool
        self.process = PROCESS
        self.sampler = sampler or Rk45()

    @classmethod
    def load(cls, weights_dir: Path | None = None, device: str = "cpu") -> PaperEstimator:
        """Load the estimator from a training's folder.

        Args:
            weights_dir: The folder; None: the shipped weights.
            device: torch device that runs the network.

        Returns:
            The estimator.

        Raises:
            AssetError: The weights are missing or unreadable.
        """
        return cls(*load(weights_dir), device)

    @classmethod
    def load_for_job(cls, weights_dir: Path | None = None, device: str = "cpu") -> PaperEstimator:
        """Load an estimator that takes what a job has: the cloud of an end effector.

        Args:
            weights_dir: The folder of a training; None: the shipped weights.
            device: torch device that runs the network.

        Returns:
            The estimator.

        Raises:
            AssetError: The weights are missing or unreadable.
            UserError: They are for clouds of whole tools; code `user.paper_column`.
        """
        estimator = cls.load(weights_dir, device)
        if estimator.of_tool:
            raise UserError(
                f"{weights_dir} was trained with --column {estimator.column.name}, which takes a whole tool's cloud, "
                "and a job has its end effector's: train with --column symmetry-aware",
                code="user.paper_column",
            )
        return estimator

    def radius(self, category: Category) -> float:
        """See `CloudEstimator`."""
        return OBJECT_RADIUS if self.column.of_tool else super().radius(category)

    def infer(
        self,
        cloud: CanonicalCloud,
        categories: list[Category],
        direction: torch.Tensor,  # noqa: ARG002 - the paper's network does not know it
        visible: Array,  # noqa: ARG002
        generator: torch.Generator,
        candidates: int,
    ) -> list[PoseResult]:
        """See `CloudEstimator.infer`."""
        seen = in_camera(cloud)
        feature = self._net.encode(seen.to(self._device))
        noise = torch.randn(len(categories), candidates, self._net.dim, generator=generator).to(feature)
        u = self.sampler(self.process, lambda u, t: self._net.score(feature, u, t), noise)
        R, p, S = (x.double().cpu().numpy() for x in decode(u))
        points = seen.double().cpu().numpy()
        p += points.mean(1, keepdims=True)
        return [self._result(c, R[b], p[b], S[b].mean(0), points[b]) for b, c in enumerate(categories)]

    def _result(self, category: Category, R: Array, p: Array, ambiguous: Array, points: Array) -> PoseResult:
        group, index = category.symmetry, CATEGORIES.index(category)
        Xs = np.tile(np.eye(4), (len(R), 1, 1))
        Xs[:, :3, :3], Xs[:, :3, 3] = R, p
        if self.column.of_tool:
            Xs = Xs @ self._net.X_tool_ee[index].double().cpu().numpy()
        if self.column.of_tool or self.column.knows_symmetry:
            ambiguous = class_ambiguity()[index].double().numpy()
        X = mean_pose(Xs, group if self.column.knows_symmetry else None)
        spin_observable = 1 - float(np.clip(ambiguous[int(np.argmax(group.axis))], 0, 1))
        covariance = scatter(Xs, X, group, spin_observable)
        spread = np.sqrt(np.trace(covariance[:3, :3])), np.sqrt(np.trace(covariance[3:, 3:]))
        hypotheses = PoseHypotheses(Xs, points, float(spread[0]), float(spread[1]), spin_observable)
        return PoseResult(category, X, covariance, 1.0, True, "ok", hypotheses, np.zeros(0), ambiguous)


def scatter(Xs: Array, X: Array, group: SymmetryGroup, spin_observable: float) -> Array:
    """Covariance of one sample about the mean.

    Args:
        Xs: Samples, (K, 4, 4).
        X: Their mean, (4, 4).
        group: Symmetry group of the EE.
        spin_observable: Predicted probability that the view shows the spin about the group's axis. Under one half the
            rotations differ modulo the group.

    Returns:
        6x6, position [m] then rotation vector [rad], axes of the samples' frame. The variance about the axis of a
        continuous group goes to pi^2/3 where the spin is unobserved.
    """
    R, dp = Xs[:, :3, :3], Xs[:, :3, 3] - X[:3, 3]
    compared = R if spin_observable >= 0.5 else align(R, X[:3, :3], group)
    w = Rotation.from_matrix(compared @ X[:3, :3].T).as_rotvec()
    covariance = np.zeros((6, 6))
    covariance[:3, :3], covariance[3:, 3:] = dp.T @ dp / len(dp), w.T @ w / len(w)
    if group.kind is not SymmetryKind.CINF:
        return covariance
    axis = np.asarray(group.axis)
    seen = min(float(np.mean(twist_angles(X[:3, :3].T @ R, axis) ** 2)), FREE_SPIN_VARIANCE)
    spin = spin_observable * seen + (1 - spin_observable) * FREE_SPIN_VARIANCE
    return with_spin_variance(covariance, X[:3, :3] @ axis, spin)


def in_camera(cloud: CanonicalCloud) -> torch.Tensor:
    """The cloud's points (B, N, 3) [m] in the camera frame: the paper does not centre them."""
    return torch.einsum("bji,bnj->bni", cloud.R, cloud.points) + cloud.centre[:, None]


def save(folder: Path, net: PaperNet, column: Column, report: dict[str, Any]) -> None:
    """Write the weights and their description.

    Args:
        folder: The folder.
        net: The network.
        column: Column of the paper's table that the network was trained for.
        report: Results of the validation.
    """
    weight_files.save_weights(folder, NAME, net.state_dict(), {"column": column.name, "report": report})


def load(folder: Path | None) -> tuple[PaperNet, Column]:
    """Load the network that `save` wrote.

    Args:
        folder: The folder; None: the shipped weights.

    Returns:
        The network (float32, eval mode, CPU), and its column of the paper's table.

    Raises:
        AssetError: The weights are missing or unreadable.
    """
    folder = folder or SHIPPED
    if not (folder / f"{NAME}.json").is_file():
        raise AssetError(
            f"{folder} holds no {NAME}.json, the paper's estimator: train it:\n{HOW_TO_TRAIN}",
            code="asset.missing",
        )
    tensors, card = weight_files.load_weights(folder, NAME)
    try:
        column = COLUMNS[card["column"]]
        net = PaperNet(column.dim)
        net.load_state_dict(tensors)
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise AssetError(
            f"the weights of the paper's estimator in {folder} are damaged, or of an earlier version: train them "
            f"again ({error})",
            code="asset.unreadable",
        ) from error
    return net.requires_grad_(False).eval(), column
