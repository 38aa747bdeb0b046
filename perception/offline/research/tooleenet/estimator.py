"""The paper's estimator: the plain mean of K = 20 samples by RK45."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.errors import AssetError, UserError
from toolee_robot.frames import Array
from toolee_robot.perception import weight_files
from toolee_robot.perception.offline.research.paper_training import HOW_TO_TRAIN
from toolee_robot.perception.offline.research.tooleenet.network import PaperNet
from toolee_robot.perception.offline.research.tooleenet.pointnet2 import ORDERED
from toolee_robot.perception.offline.research.tooleenet.pooling import mean_pose
from toolee_robot.perception.offline.research.tooleenet.representation import class_ambiguity, decode
from toolee_robot.perception.offline.research.tooleenet.rk45 import Rk45
from toolee_robot.perception.pose.canonical import CanonicalCloud
from toolee_robot.perception.pose.cloud_estimator import CloudEstimator, PoseResult
from toolee_robot.perception.pose.pooling import FREE_SPIN_VARIANCE, align
from toolee_robot.perception.pose.processes.flow import Sampler
from toolee_robot.perception.pose.processes.variance_exploding import VarianceExploding
from toolee_robot.perception.pose.rotations import twist_angles
from toolee_robot.perception.pose.spin import with_spin_variance
from toolee_robot.perception.precision import torch_device
from toolee_robot.symmetry import SymmetryGroup, SymmetryKind
from toolee_robot.types import PoseHypotheses

NAME = "pose_paper"
POINTS = 1024
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
        start: Time at which sampling starts, see `VarianceExploding`; None: the paper's.

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
        start: float | None = None,
    ) -> None:
        self._device = torch_device(device)
        self._net = net.to(self._device).eval()
        self.column, self.of_tool = column, column.of_tool
        self.process = PROCESS if start is None else replace(PROCESS, start=start)
        self.sampler = sampler or Rk45()

    @classmethod
    def load(cls, weights_dir: Path, device: str = "cpu") -> PaperEstimator:
        """Load the estimator from a training's folder.

        Args:
            weights_dir: The folder.
            device: torch device that runs the network.

        Returns:
            The estimator.

        Raises:
            AssetError: The weights are missing or unreadable.
        """
        net, column, start = load(weights_dir)
        return cls(net, column, device, start=start)

    @classmethod
    def load_for_job(cls, weights_dir: Path, device: str = "cpu") -> PaperEstimator:
        """Load an estimator that takes what a job has: the cloud of an end effector.

        Args:
            weights_dir: The folder of a training.
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
        return PoseResult(category, X, covariance, 1.0, True, "ok", hypotheses, (1.0,), np.zeros(0), ambiguous)


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


def load(folder: Path) -> tuple[PaperNet, Column, float]:
    """Load the network that `save` wrote.

    Args:
        folder: The folder.

    Returns:
        The network (float32, eval mode, CPU), its column of the paper's table, and the time at which sampling starts.

    Raises:
        AssetError: The weights are missing or unreadable.
    """
    if not (folder / f"{NAME}.json").is_file():
        raise AssetError(
            f"{folder} holds no {NAME}.json: the paper's estimator is not shipped; train it:\n{HOW_TO_TRAIN}",
            code="asset.missing",
        )
    tensors, card = weight_files.load_weights(folder, NAME)
    try:
        column, start = COLUMNS[card["column"]], float(card.get("sampling_start", PROCESS.start))
        if not PROCESS.end < start <= 1:
            raise ValueError(f"sampling_start {start:g} is not within ({PROCESS.end:g}, 1]")
        net = PaperNet(column.dim)
        net.load_state_dict(tensors)
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise AssetError(
            f"the weights of the paper's estimator in {folder} are unreadable: {error}", code="asset.unreadable"
        ) from error
    return net.requires_grad_(False).eval(), column, start
