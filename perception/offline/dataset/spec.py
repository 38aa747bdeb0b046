"""Specification of a data set, its division into scenes, and which data sets are test sets."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from toolee_robot import __version__
from toolee_robot.depth_noise import KINDS, SensorKind
from toolee_robot.errors import UserError, words_of
from toolee_robot.perception.offline.dataset.catalogue import (
    FIRST_KINDS,
    GENERATED,
    Catalogue,
    CustomToolRecord,
    CustomTools,
    GeneratedTools,
    generated_tools,
)
from toolee_robot.perception.offline.dataset.records import read_json
from toolee_robot.runtime.files import from_json, read_text
from toolee_robot.tools import TOOL_SPECS

CONFIGS = ("paper", "hard")
"""Scene configurations."""
SPLITS = ("train", "test")
"""Splits; "test" shows held-out instances, textures and backgrounds."""
DEVICES = ("cpu", "cuda")
"""Rendering devices."""
LICENCE = "MIT"
TEST_SEEDS = frozenset({7001, 7002, 7004, 7010, 7601, 7801})
"""Seeds of test sets: those from before data sets could say so themselves, and the one of the published figures."""
FORMAT = 1
"""Version of the format, a field of `DESCRIPTION`."""
DESCRIPTION = "dataset.json"
"""File with the specification, in the folder of the data set."""

LARGEST = 10_000_000
"""Most examples of a data set: a thousand times the largest that was made."""


@dataclass(frozen=True)
class SceneJob:
    """The examples of one BOP scene.

    Attributes:
        split: "train" or "test".
        scene: Number of the scene in the split.
        first: Index of the first example in the split.
        last: Index after the last example.
    """

    split: str
    scene: int
    first: int
    last: int

    def folder(self, root: Path) -> Path:
        """Folder of the scene in the data set at `root`."""
        return root / self.split / f"{self.scene:06d}"


@dataclass(frozen=True)
class DatasetSpec:
    """Specification of a data set. Equal specifications give identical bytes.

    Attributes:
        config: Scene configuration, one of `CONFIGS`.
        size: Number of examples in both splits.
        seed: Random seed, 0 to 2^31 - 1.
        test_share: Share of the test split, in [0, 1]; it shows held-out instances, textures and backgrounds.
        scene_size: Examples in a BOP scene; they share a pool of about a dozen tools.
        tools: Custom tools, which replace the generated ones; all of them are held out.
        device: Rendering device, "cpu" or "cuda"; the two differ by rounding.
        test_set: Whether it is a test set, whose every scoring is entered in the ledger (`evaluation.ledger`).
        sensor: Kind of the depth camera, one of `sensor_kinds.KINDS`; that of "paper" is free of noise.
        kinds: Kinds of generated tools that it is drawn from, the first ones of `TOOL_SPECS`, at least `FIRST_KINDS`.

    Raises:
        UserError: A value is out of range, or custom tools are combined with a training split.
    """

    config: str
    size: int
    seed: int = 0
    test_share: float = 0.1
    scene_size: int = 32
    tools: tuple[CustomToolRecord, ...] = ()
    device: str = "cpu"
    test_set: bool = False
    sensor: SensorKind = "time-of-flight"
    kinds: int = len(TOOL_SPECS)

    def __post_init__(self) -> None:
        if self.config not in CONFIGS:
            raise UserError(f"--config {self.config}: choose one of {', '.join(CONFIGS)}")
        if self.device not in DEVICES:
            raise UserError(f"--device {self.device}: choose one of {', '.join(DEVICES)}")
        if self.sensor not in KINDS:
            raise UserError(f"--sensor {self.sensor}: choose one of {', '.join(KINDS)}")
        if self.sensor != "time-of-flight" and self.config != "hard":
            raise UserError(f"--sensor {self.sensor}: the camera of --config {self.config} has no noise, choose hard")
        if not FIRST_KINDS <= self.kinds <= len(TOOL_SPECS):
            raise UserError(f"--kinds {self.kinds}: give {FIRST_KINDS} to {len(TOOL_SPECS)}", code="user.kinds")
        if self.size < 1 or self.scene_size < 1:
            raise UserError(f"--size {self.size}, scenes of {self.scene_size}: both must be 1 or more")
        if self.size > LARGEST:
            raise UserError(f"--size {self.size}: give {LARGEST:,} or fewer")
        if not 0 <= self.seed < 2**31:
            raise UserError(f"--seed {self.seed}: give a whole number from 0 to {2**31 - 1}")
        if not 0.0 <= self.test_share <= 1.0:
            raise UserError(f"--test-share {self.test_share}: give a share from 0 to 1")
        if self.tools and self.test_share != 1.0:
            raise UserError(f"--test-share {self.test_share}: one's own tools are all held out, leave it out or give 1")

    @property
    def is_test_set(self) -> bool:
        """Whether it was made as a test set, or has the seed of one."""
        return self.test_set or self.seed in TEST_SEEDS

    @property
    def counts(self) -> dict[str, int]:
        """Number of examples of each split."""
        test = round(self.size * self.test_share)
        if 0.0 < self.test_share < 1.0 and self.size > 1:
            test = min(max(test, 1), self.size - 1)
        return {"train": self.size - test, "test": test}

    def jobs(self) -> list[SceneJob]:
        """All scenes, those of the test split last."""
        step = self.scene_size
        return [
            SceneJob(split, k, first, min(first + step, count))
            for split, count in self.counts.items()
            for k, first in enumerate(range(0, count, step))
        ]

    def to_json(self) -> dict[str, Any]:
        """Content of `DESCRIPTION`."""
        asked = {k: getattr(self, k) for k in ("config", "size", "seed", "test_share", "scene_size", "device")}
        data = {"format": FORMAT, **asked, "generator": f"toolee_robot {__version__}", "licence": LICENCE}
        if self.test_set:
            data["test_set"] = True
        if self.sensor != "time-of-flight":
            data["sensor"] = self.sensor
        if self.tools:
            data["tools"] = [tool.to_json() for tool in self.tools]
        elif self.kinds != FIRST_KINDS:
            data["kinds"] = self.kinds
        return data

    def catalogue(self, root: Path) -> Catalogue:
        """Catalogue of the tools of the data set in the folder `root`."""
        return CustomTools(root, self.tools) if self.tools else generated_tools(self.kinds)

    @staticmethod
    def read(root: Path) -> DatasetSpec:
        """Read the specification of a data set.

        Args:
            root: Folder of the data set.

        Raises:
            UserError: The folder has no data set, its specification is unreadable, or it has another format version or
                more kinds of tools (`user.newer_data_set`).
        """
        path = root / DESCRIPTION
        try:
            data = from_json(read_text(path))
            config, kinds = data["config"], data.get("kinds", len(TOOL_SPECS) if "tools" in data else FIRST_KINDS)
            if kinds > len(TOOL_SPECS):
                raise UserError(
                    f"{path} is of a newer version of this program: its tools are of {kinds} kinds, of which "
                    f"{len(TOOL_SPECS)} are known here; update the program",
                    code="user.newer_data_set",
                )
            if "renderer" in data:
                raise UserError(f"{path} is of the path tracer, which this version no longer has: use commit 1855b4dc")
            spec = DatasetSpec(
                config,
                data["size"],
                data["seed"],
                float(data["test_share"]),
                data["scene_size"],
                tuple(CustomToolRecord.from_json(tool) for tool in data.get("tools", ())),
                data["device"],
                bool(data.get("test_set", False)),
                data.get("sensor", "time-of-flight"),
                kinds,
            )
        except FileNotFoundError as error:
            raise UserError(
                f"{root} holds no data set ({path} is missing): make one with `toolee dataset generate`"
            ) from error
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise UserError(f"{path} cannot be read ({words_of(error)}): generate the data set again") from error
        if data.get("format") != FORMAT:
            raise UserError(f"{path} is of format {data.get('format')}, this program reads {FORMAT}: generate it again")
        return spec


def root_of(folder: Path) -> Path | None:
    """Folder of the data set that a folder belongs to.

    Args:
        folder: Folder of a data set or of one of its splits.

    Returns:
        The folder with the specification; None where neither the folder nor the one above it has one.
    """
    folder = folder.resolve()
    return next((root for root in (folder, folder.parent) if (root / DESCRIPTION).is_file()), None)


def catalogue_of(folder: Path) -> Catalogue:
    """Catalogue of the tools of a data set or one of its splits.

    Args:
        folder: Folder of the data set or of a split.

    Returns:
        The catalogue that the specification names; the generated tools if there is no specification.
    """
    root = root_of(folder)
    return GENERATED if root is None else DatasetSpec.read(root).catalogue(root)


def generated_catalogue_of(folder: Path) -> GeneratedTools:
    """Catalogue for scenes that are rendered beside a data set or one of its splits, as those of its evaluation.

    Args:
        folder: Folder of the data set or of a split.

    Returns:
        The generated tools of the kinds that it is drawn from; of all kinds if its tools are custom ones or there is no
        specification.
    """
    root = root_of(folder)
    return GENERATED if root is None else generated_tools(DatasetSpec.read(root).kinds)


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
