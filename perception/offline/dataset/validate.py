"""Is a data set what was generated? Finds files that are missing, broken, changed or that do not belong to it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from toolee_robot.errors import AssetError
from toolee_robot.perception.offline.dataset.index_files import is_finished, listed
from toolee_robot.perception.offline.dataset.records import SUMS, read_sums
from toolee_robot.perception.offline.dataset.spec import SPLITS, DatasetSpec
from toolee_robot.runtime.files import sha256


@dataclass(frozen=True, order=True)
class Fault:
    """A fault of a data set.

    Attributes:
        file: Path of the file in the data set.
        problem: What is wrong with it, for a person.
    """

    file: str
    problem: str


def validate(root: Path, progress: Callable[[int, int], None] | None = None) -> list[Fault]:
    """Compare every file of a data set with its checksum.

    Args:
        root: Folder of the data set.
        progress: Called with the number of examples checked and the number of all.

    Returns:
        The faults, sorted by file; none if the data set is sound.

    Raises:
        UserError: There is no data set in the folder.
    """
    spec = DatasetSpec.read(root)
    faults = set(_root_faults(spec, root))
    done = 0
    for job in spec.jobs():
        if job.folder(root).is_dir():
            faults.update(_faults_of(job.folder(root), None, f"{job.split}/{job.scene:06d}/"))
        done += job.last - job.first
        if progress is not None:
            progress(done, spec.size)
    return sorted(faults)


def _root_faults(spec: DatasetSpec, root: Path) -> Iterator[Fault]:
    if not is_finished(root):
        yield Fault(SUMS, "missing: the generation has not finished, run the same command again")
    else:
        yield from _faults_of(root, set(listed(root)))
    wanted = {f"{job.split}/{job.scene:06d}" for job in spec.jobs()}
    there = {f"{split}/{p.name}" for split in SPLITS for p in (root / split).glob("*")}
    for scene in sorted(wanted - there):
        yield Fault(scene, "missing: the whole scene is not there")
    for scene in sorted(there - wanted):
        yield Fault(scene, "does not belong to this data set")


def _faults_of(folder: Path, expected: set[str] | None, prefix: str = "") -> Iterator[Fault]:
    """Faults of a folder's files; expected: those that must be listed, None for all that are there."""
    try:
        sums = read_sums(folder)
    except AssetError:
        yield Fault(prefix + SUMS, "missing" if not (folder / SUMS).exists() else "not a list of checksums")
        return
    if expected is None:
        there = (p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())
        expected = {name for name in there if name != SUMS}
    for name in sorted(expected - set(sums)):
        yield Fault(prefix + name, f"not listed in {SUMS}: it is not part of the data set")
    for name, digest in sums.items():
        path = folder / name
        if not path.is_file():
            yield Fault(prefix + name, "missing")
        elif path.stat().st_size == 0:
            yield Fault(prefix + name, "empty")
        elif sha256(path) != digest:
            yield Fault(prefix + name, f"changed or corrupted: its SHA-256 is not the one in {SUMS}")
