"""Test sets are for reports: nothing is trained or fitted on them."""

from __future__ import annotations

from pathlib import Path

from toolee_robot.errors import UserError
from toolee_robot.perception.offline.dataset.files import read_json
from toolee_robot.perception.offline.dataset.spec import DatasetSpec, root_of

PHOTOGRAPHS = "frames.json"
"""Description of a set of photographs; with `"test_set": true` it is a test set."""


def are_test_photographs(folder: Path) -> bool:
    """Whether a folder holds a set of photographs that is a test set.

    Args:
        folder: The folder.

    Raises:
        AssetError: The set's description is damaged.
    """
    if not (folder / PHOTOGRAPHS).is_file():
        return False
    description = read_json(folder / PHOTOGRAPHS)
    return isinstance(description, dict) and description.get("test_set") is True


def refuse_test_set(folder: Path) -> None:
    """Refuse to train or fit on a test set; asked before any image is read.

    Args:
        folder: Folder of a data set, of one of its splits, or of a set of photographs. One that does not exist, or has
            no description, passes.

    Raises:
        UserError: It is a test set (`user.test_set`).
        AssetError: The description of a set of photographs is damaged.
    """
    if are_test_photographs(folder):
        raise UserError(
            f"{folder} is a test set of photographs, on which nothing may be trained: take other photographs",
            code="user.test_set",
        )
    root = root_of(folder)
    if root is None or not (spec := DatasetSpec.read(root)).is_test_set:
        return
    raise UserError(
        f"{folder} is a test set (seed {spec.seed}), on which nothing may be trained or fitted: take another seed, "
        "`toolee dataset generate --seed N` without --test-set",
        code="user.test_set",
    )
