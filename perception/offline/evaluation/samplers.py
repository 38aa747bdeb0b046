"""The table of samplers: accuracy against network evaluations and time, on one network and the same clouds."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

from toolee_robot.end_effectors import CATEGORIES
from toolee_robot.perception.offline.evaluation import metrics
from toolee_robot.perception.offline.evaluation.estimates import estimate_case
from toolee_robot.perception.offline.evaluation.records import Examples
from toolee_robot.perception.offline.research.tooleenet.rk45 import Rk45
from toolee_robot.perception.pose.cloud_estimator import CloudEstimator
from toolee_robot.perception.pose.processes.flow import Euler, Field, Process, Sampler

STEPS = (1, 2, 3, 5, 10, 20)
REFERENCE = "RK45"
"""Name of the reference sampler."""


@dataclass
class Measured:
    """A sampler that records its network evaluations and its time.

    Attributes:
        sampler: The sampler.
        evaluations: Network evaluations of each call.
        seconds: Time of each call [s].
    """

    sampler: Sampler
    evaluations: list[int] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)

    def __call__(self, process: Process, network: Field, noise: Tensor) -> Tensor:
        """See `Sampler`."""
        count = 0

        def counted(u: Tensor, t: Tensor) -> Tensor:
            nonlocal count
            count += 1
            return network(u, t)

        _wait(noise)
        begun = time.perf_counter()
        data = self.sampler(process, counted, noise)
        _wait(data)
        self.seconds.append(time.perf_counter() - begun)
        self.evaluations.append(count)
        return data


def sampler_table(
    estimator: CloudEstimator, examples: Examples, limit: int, progress: Callable[[int, int], None]
) -> list[dict[str, Any]]:
    """Evaluate the samplers one cloud at a time, all from the same noise.

    Args:
        estimator: The estimator whose network is sampled.
        examples: The data set.
        limit: Number of clouds under true masks, held-out tools first.
        progress: Called with the finished number of estimates and their total.

    Returns:
        One row per sampler; "average" is the mean of the categories' shares.
    """
    chosen = [c for c in examples.cases["truth"] if c.instance is not None and c.cloud.usable]
    chosen.sort(key=lambda c: not examples.instances[c.instance or 0].held_out)
    chosen = chosen[:limit]
    samplers: dict[str, Sampler] = {REFERENCE: Rk45()} | {f"{n} step{'s' * (n > 1)}": Euler(n) for n in STEPS}
    usual = estimator.sampler
    rows = []
    try:
        for number, (name, sampler) in enumerate(samplers.items()):
            measured = Measured(sampler)
            estimator.sampler = measured
            angle, position, category = [], [], []
            for k, case in enumerate(chosen):
                result, _ = estimate_case(estimator, case, seed=k)
                instance = examples.instances[case.instance or 0]
                X, X_true = np.full((4, 4), np.nan), instance.X_camera_ee
                if result is not None:
                    X = result.X_camera_ee
                known = result is not None
                group = instance.category.symmetry
                angle.append(group.rotation_error(X[:3, :3], X_true[:3, :3]) if known else np.inf)
                position.append(float(np.linalg.norm(X[:3, 3] - X_true[:3, 3])) if known else np.inf)
                category.append(CATEGORIES.index(instance.category))
                progress(number * len(chosen) + k + 1, len(samplers) * len(chosen))
            rows.append(_row(name, measured, np.array(angle), np.array(position), np.array(category)))
    finally:
        estimator.sampler = usual
    for row in rows:
        row["speed_up"] = rows[0]["median_ms"] / row["median_ms"]
        row["5deg2cm_points_lost"] = 100 * (rows[0]["average"]["5deg2cm"] - row["average"]["5deg2cm"])
    return rows


def _row(name: str, measured: Measured, angle: Any, position: Any, category: Any) -> dict[str, Any]:
    each = [metrics.shares(angle[category == c], position[category == c]) for c in np.unique(category)]
    made = np.isfinite(position)
    return {
        "sampler": name,
        "clouds": len(angle),
        "evaluations": float(np.mean(measured.evaluations)),
        # The first calls warm the caches.
        "median_ms": 1e3 * float(np.median(measured.seconds[3:] or measured.seconds)),
        "average": {k: float(np.mean([e[k] for e in each])) for k in metrics.THRESHOLDS},
        "median_mm": 1e3 * float(np.median(position[made])) if made.any() else None,
        "median_deg": float(np.rad2deg(np.median(angle[made]))) if made.any() else None,
    }


def _wait(x: Tensor) -> None:
    if x.is_cuda:
        torch.cuda.synchronize(x.device)
