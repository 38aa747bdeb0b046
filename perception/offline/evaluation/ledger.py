"""The ledger of test sets: every scoring of one enters itself, because a test set is spent by looking.

The file is part of the repository and is committed with what was decided by the figures.
"""

from __future__ import annotations

import json
import subprocess
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import toolee_robot
from toolee_robot.errors import AssetError, UserError
from toolee_robot.perception.offline.dataset.records import SUMS
from toolee_robot.perception.offline.dataset.spec import PHOTOGRAPHS, DatasetSpec, are_test_photographs, root_of
from toolee_robot.perception.weight_files import WEIGHTS_DIR, weights_hash
from toolee_robot.runtime.files import sha256

LEDGER = Path(toolee_robot.__file__).resolve().parents[1] / "docs" / "results" / "test_ledger.jsonl"
"""The repository's ledger: one scoring a line, the newest last."""


@dataclass(frozen=True)
class Ledger:
    """The ledger, for one test set.

    Attributes:
        path: The ledger's file.
        data: What identifies the data set: its name, specification and hash.
    """

    path: Path
    data: dict[str, Any]

    @staticmethod
    def of(folder: Path, path: Path | None = None) -> Ledger | None:
        """The ledger that a scoring of a data set must enter; asked for before anything is scored.

        Args:
            folder: Folder of a data set, of one of its splits, or of a set of photographs.
            path: The ledger's file; None: the repository's.

        Returns:
            The ledger; None where the data set is no test set.

        Raises:
            UserError: It is a test set and there is no ledger, as in an installed package without the repository.
            AssetError: Its description is damaged.
        """
        found = _test_set(folder)
        if found is None:
            return None
        path = LEDGER if path is None else path
        if not path.is_file():
            raise UserError(
                f"{folder} is a test set, and its ledger {path} is missing. Evaluate it in a checkout of the "
                "repository, where each evaluation is logged",
            )
        return Ledger(path, found)

    def enter(
        self, scoring: str, weights: dict[str, Path | None], figures: dict[str, Any], limit: int | None = None
    ) -> None:
        """Append a scoring to the ledger.

        Args:
            scoring: What was scored, such as "pose".
            weights: Label to folder of weights; None: the shipped ones.
            figures: The main figures, as a JSON object.
            limit: Largest number of images that were scored; None: all.

        Raises:
            OSError: The ledger cannot be written.
        """
        entry = {
            "date": datetime.now(UTC).isoformat(timespec="seconds"),
            "scoring": scoring,
            "commit": _commit(self.path.parent),
            "data": self.data,
            "limit": limit,
            "weights": {label: weights_hash(folder or WEIGHTS_DIR) for label, folder in weights.items()},
            "figures": figures,
        }
        with self.path.open("a") as file:
            file.write(json.dumps(entry) + "\n")


def pose_figures(report: dict[str, Any]) -> dict[str, Any]:
    """The main figures of a pose evaluation: shares of held-out tools within 5 deg and 2 cm, and usable poses.

    Args:
        report: Contents of report.json.

    Returns:
        Estimator to kind of masks to category, "average" among them, to share.
    """
    figures: dict[str, Any] = {}
    for label, record in report["estimators"].items():
        for masks in ("truth", "predicted"):
            groups = record.get(masks, {}).get("groups", {})
            if "held-out" in groups:
                rows = groups["held-out"]["table"]
                shares = {category: round(row["5deg2cm"], 4) for category, row in rows.items()}
                figures.setdefault(label, {})[masks] = {**shares, "usable": record[masks]["usable"]}
    return {"5deg2cm": figures, **{k: report[k] for k in ("no_tool",) if k in report}}


def _test_set(folder: Path) -> dict[str, Any] | None:
    """What identifies a test set; None for another data set."""
    if (folder / PHOTOGRAPHS).is_file():
        if not are_test_photographs(folder):
            return None
        return {"name": folder.resolve().name, "sha256": sha256(folder / PHOTOGRAPHS)}
    root = root_of(folder)
    if root is None or not (spec := DatasetSpec.read(root)).is_test_set:
        return None
    sums = root / SUMS
    if not sums.is_file():
        raise AssetError(f"{root} is not finished: run its `toolee dataset generate` again")
    asked = {k: getattr(spec, k) for k in ("config", "size", "seed", "test_share", "device", "sensor")}
    if not spec.tools:
        asked["kinds"] = spec.kinds
    return {"name": root.name, **asked, "sha256": sha256(sums)}


def _commit(folder: Path) -> str:
    """The commit checked out in a folder, with "+" where files differ from it; "unknown" without git."""
    try:
        head, changes = (
            subprocess.run(["git", *args], cwd=folder, capture_output=True, text=True, check=True).stdout.strip()
            for args in (("rev-parse", "HEAD"), ("status", "--porcelain", "--untracked-files=no"))
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return head + ("+" if changes else "")
