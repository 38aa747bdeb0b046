"""Ablations: one training per design decision, on the same clouds and budget, and the table of the results.

    toolee train ablations --out runs/ablations --max-steps 30000
    toolee train ablations --out runs/ablations --minutes 10 --rows base,flow --device cuda:1

Several processes may share a folder, each with its own rows and device: every row has its folder (weights, log,
checkpoint, row.json), and each process rewrites ablations.json and ablations.md from all rows that are there.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from toolee_robot.end_effectors import label_of
from toolee_robot.perception.offline.pose import validation
from toolee_robot.perception.offline.pose.config import TrainConfig
from toolee_robot.perception.offline.pose.recipe import DefaultRecipe, TrainingRecipe
from toolee_robot.perception.offline.pose.trainer import Trainer
from toolee_robot.perception.offline.research.ablation_variants import POOLINGS, Uncentred, WithPointNet
from toolee_robot.perception.offline.research.tooleenet import PaperRecipe
from toolee_robot.perception.offline.synthetic_clouds.batch import CloudBatch, CloudConfig
from toolee_robot.perception.offline.synthetic_clouds.surface_samples import sample_hands, sample_tools
from toolee_robot.perception.offline.training.distributed import init_distributed
from toolee_robot.perception.pose.cloud_estimator import CANDIDATES, CloudEstimator, PoseResult
from toolee_robot.perception.pose.estimator import PoseEstimator
from toolee_robot.perception.pose.network import NetworkConfig
from toolee_robot.perception.pose.processes.flow import Euler
from toolee_robot.perception.pose.weights import Calibration

KS = (1, 5, 10, 20, 32, 50)
STEPS = (1, 2, 3, 5, 10, 20)
RADII_MM = (40, 50, 60, 70)
_NAME = "ablation"
"""Name of the rows' weights, which are not for use in the pipeline."""


@dataclass(frozen=True)
class Row:
    """One training of the ablations.

    Attributes:
        what: The design decision.
        change: Difference from the base.
        recipe: Its training recipe.
    """

    what: str
    change: str
    recipe: TrainingRecipe[Any]


def _default(**changes: Any) -> DefaultRecipe:
    return DefaultRecipe(name=_NAME, **changes)


ROWS: dict[str, Row] = {
    "base": Row("base", "patch transformer, EDM, rest of the tool, centred, augmented", _default()),
    "pointnet2": Row("encoder", "the paper's PointNet++", WithPointNet(name=_NAME)),
    "flow": Row("process", "flow matching", _default(config=NetworkConfig(process="flow"))),
    "score": Row(
        "process",
        "score matching (VE), 20 steps",
        _default(config=NetworkConfig(process="score"), sampler=Euler(20)),
    ),
    "no-rest": Row("rest of the tool", "its direction alone, no points", _default(rest_dropout=1.0)),
    "no-direction": Row("rest of the tool", "unknown", _default(rest_dropout=1.0, direction_dropout=1.0)),
    "uncentred": Row("centring", "encoder sees the cloud in the camera's frame", Uncentred(name=_NAME)),
    "no-augmentation": Row("augmentation", "without", _default(augmentation=False)),
    "no-guesses": Row("pixels without a depth", "left out", _default(clouds_config=CloudConfig(guessed=False))),
    **{
        f"radius-{r}": Row(
            "crop radius", f"{r} mm for every category", _default(clouds_config=CloudConfig(radius=r / 1e3))
        )
        for r in RADII_MM
    },
    "paper": Row("all of it", "the paper's estimator", PaperRecipe()),
}


def run_row(name: str, out: Path, config: TrainConfig, samples: Any, hands: Any) -> None:
    """Train a row (or resume it), evaluate it and write its row.json.

    Args:
        name: Name of the row in `ROWS`.
        out: Folder of the table.
        config: Options of the training.
        samples: Surface samples of training and of held-out tools.
        hands: Surface samples of hands.

    Raises:
        TooleeError: The loss is not finite.
    """
    row = ROWS[name]
    with init_distributed(config.device) as distributed:
        trainer: Trainer[Any] = Trainer(out / name, config, samples, hands, row.recipe, distributed)
        report = trainer.run()
        held_out = trainer.judged()
        estimator = row.recipe.estimator(trainer.export(), Calibration(), str(distributed.device))
        K = estimator.candidates
        record: dict[str, Any] = {
            "what": row.what,
            "change": row.change,
            "steps": report["steps"],
            "minutes": report["minutes"],
            "parameters": sum(p.numel() for p in trainer.net.parameters()),
            "candidates": K,
            "metrics": validation.metrics(validation.evaluate(estimator, held_out, K)),
        }
        if name == "base":
            record["evaluated"] = without_training(estimator, held_out)
        (out / name / "row.json").write_text(json.dumps(record, indent=1) + "\n")


def without_training(estimator: CloudEstimator, held_out: CloudBatch) -> list[dict[str, Any]]:
    """Evaluate the decisions that need no training on the base's network: number of candidates, steps, pooling.

    Args:
        estimator: The base's estimator.
        held_out: Held-out clouds.

    Returns:
        One row per setting, with its metrics.
    """
    assert isinstance(estimator, PoseEstimator)
    rows = []
    for k in KS:
        found = validation.evaluate(estimator, held_out, k)
        rows.append({"what": "K", "change": str(k), "metrics": validation.metrics(found)})
    usual = estimator.sampler
    for steps in STEPS:
        estimator.sampler = Euler(steps)
        found = validation.evaluate(estimator, held_out, CANDIDATES)
        rows.append({"what": "steps", "change": str(steps), "metrics": validation.metrics(found)})
    estimator.sampler = usual
    results = validation.evaluate(estimator, held_out, CANDIDATES).results
    for name, pooling in POOLINGS.items():
        pooled: list[PoseResult] = [
            replace(r, X_camera_ee=pooling(r.hypotheses.Xs_camera_ee, r.category.symmetry)) for r in results
        ]
        found = validation.Evaluated(held_out, pooled)
        rows.append({"what": "pooling", "change": name, "metrics": validation.metrics(found)})
    return rows


def run_rows(names: Sequence[str], out: Path, config: TrainConfig) -> None:
    """Train these rows, one after the other, and rewrite the table after each.

    Args:
        names: Some of `ROWS`.
        out: Folder of the table, with a folder for each row.
        config: The budget of each row.

    Raises:
        TooleeError: A loss is not finite.
    """
    samples = sample_tools(False, config.train_seeds), sample_tools(True, config.test_seeds)
    hands = sample_hands()
    for name in names:
        run_row(name, out, config, samples, hands)
        write_table(out)


def write_table(out: Path) -> str:
    """Write ablations.json and ablations.md from the rows that are there; returns the text of the latter."""
    rows: list[dict[str, Any]] = []
    for name in ROWS:
        path = out / name / "row.json"
        if path.is_file():
            record = json.loads(path.read_text())
            evaluated = record.pop("evaluated", [])
            rows += [{"row": name, **record}, *({"row": f"{r['what']} {r['change']}", **r} for r in evaluated)]
    (out / "ablations.json").write_text(json.dumps(rows, indent=1) + "\n")
    text = _markdown(rows)
    (out / "ablations.md").write_text(text)
    return text


def _markdown(rows: list[dict[str, Any]]) -> str:
    categories = list(dict.fromkeys(c for r in rows for c in r["metrics"] if c != "average"))
    names = [label_of(c) for c in categories]
    head = ["decision", "change", "steps", "min", "5° 2 cm", "5° 1 cm", "10° 2 cm", "mm", "°", *names]
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    for r in rows:
        average = r["metrics"]["average"]
        shares = [f"{average[k]:.3f}" for k in ("5deg_2cm", "5deg_1cm", "10deg_2cm")] if average else ["–"] * 3
        medians = [f"{average[k]:.2f}" for k in ("median_mm", "median_deg")] if average else ["–"] * 2
        each = [f"{r['metrics'][c]['5deg_1cm']:.3f}" if c in r["metrics"] else "–" for c in categories]
        budget = [str(r.get("steps", "")), str(r.get("minutes", ""))]
        lines.append(f"| {' | '.join([r['what'], r['change'], *budget, *shares, *medians, *each])} |")
    note = "Held-out tools, generated clouds. Columns by category: share within 5° 1 cm; medians: mean over categories."
    return "\n".join([*lines, "", note]) + "\n"
