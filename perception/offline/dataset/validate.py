"""Is a data set what it says? Finds files that are missing, broken, changed or that contradict one another."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from toolee_robot.errors import AssetError, TooleeError
from toolee_robot.perception.offline.dataset.card import GENERATED_BY
from toolee_robot.perception.offline.dataset.files import SUMS, read_sums
from toolee_robot.perception.offline.dataset.index_files import COCO, README, Summary, is_finished, listed
from toolee_robot.perception.offline.dataset.instances import MODELS
from toolee_robot.perception.offline.dataset.parallel import on_processes
from toolee_robot.perception.offline.dataset.scene_check import check_scene
from toolee_robot.perception.offline.dataset.spec import SPLITS, DatasetSpec, SceneJob
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


def validate(root: Path, workers: int = 1, progress: Callable[[int, int], None] | None = None) -> list[Fault]:
    """Check a data set; every file is read.

    Args:
        root: Folder of the data set.
        workers: Number of processes.
        progress: Called with the number of examples checked and the number of all.

    Returns:
        The faults, sorted by file; none if the data set is sound.

    Raises:
        UserError: There is no data set in the folder.
    """
    spec = DatasetSpec.read(root)
    faults = set(_root_faults(spec, root))
    done = 0
    jobs = [job for job in spec.jobs() if job.folder(root).is_dir()]
    check = partial(scene_faults, spec, root)
    results = (check(job) for job in jobs) if workers == 1 else on_processes(check, jobs, workers)
    for job, found in results:
        faults.update(found)
        done += job.last - job.first
        if progress is not None:
            progress(done, spec.size)
    if not any(fault.file.split("/")[0] in SPLITS for fault in faults):
        faults.update(_derived_faults(spec, root))
    return sorted(faults)


def scene_faults(spec: DatasetSpec, root: Path, job: SceneJob) -> tuple[SceneJob, list[Fault]]:
    """Check one scene.

    Args:
        spec: What the data set was generated from.
        root: Folder of the data set.
        job: The scene.

    Returns:
        The scene and its faults.
    """
    name = f"{job.split}/{job.scene:06d}"
    checked = [Fault(f"{name}/{file}", problem) for file, problem in check_sums(job.folder(root), None)]
    faults = [*checked]
    broken = {fault.file for fault in checked}
    # A fault that the checksums show is reported once.
    for file, problem in check_scene(spec, root, job):
        if f"{name}/{file}" not in broken:
            faults.append(Fault(f"{name}/{file}", problem))
    return job, faults


def check_sums(folder: Path, expected: set[str] | None) -> Iterator[tuple[str, str]]:
    """Check the files of a folder against its SHA256SUMS.

    Args:
        folder: The folder.
        expected: Files that must be listed; None: all that are there.

    Yields:
        File, relative to the folder, and problem.
    """
    try:
        sums = read_sums(folder)
    except AssetError:
        yield SUMS, "missing" if not (folder / SUMS).exists() else "not a list of checksums"
        return
    if expected is None:
        there = (p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())
        expected = {name for name in there if name != SUMS}
    for name in sorted(expected - set(sums)):
        yield name, f"not listed in {SUMS}: it is not part of the data set"
    for name, digest in sums.items():
        path = folder / name
        if not path.is_file():
            yield name, "missing"
        elif path.stat().st_size == 0:
            yield name, "empty"
        elif sha256(path) != digest:
            yield name, f"changed or corrupted: its SHA-256 is not the one in {SUMS}"


def _root_faults(spec: DatasetSpec, root: Path) -> Iterator[Fault]:
    if not is_finished(root):
        yield Fault(SUMS, "missing: the generation has not finished, run the same command again")
    else:
        for file, problem in check_sums(root, set(listed(root))):
            yield Fault(file, problem)
    wanted = {f"{job.split}/{job.scene:06d}" for job in spec.jobs()}
    there = {f"{split}/{p.name}" for split in SPLITS for p in (root / split).glob("*")}
    for scene in sorted(wanted - there):
        yield Fault(scene, "missing: the whole scene is not there")
    for scene in sorted(there - wanted):
        yield Fault(scene, "does not belong to this data set")


def _derived_faults(spec: DatasetSpec, root: Path) -> Iterator[Fault]:
    """Regenerate the files that follow from the scenes, and compare them."""
    with tempfile.TemporaryDirectory() as name:
        out = Path(name)
        (out / MODELS).mkdir()
        try:
            summary = Summary(spec, root)
            for job in spec.jobs():
                summary.add(job)
            summary.write(out)
        except (TooleeError, KeyError, ValueError, TypeError) as error:
            yield Fault(COCO, f"cannot be derived from the scenes: {error}")
            return
        for path in sorted(p for p in out.rglob("*") if p.is_file()):
            file = path.relative_to(out).as_posix()
            if (root / file).is_file() and not _agree(root / file, path):
                yield Fault(file, "contradicts the scenes: it is not what follows from them")


def _agree(path: Path, derived: Path) -> bool:
    """Whether a file is the derived one; of the data card's words, all but the command, which older versions cut."""
    if path.name != README:
        return sha256(path) == sha256(derived)
    return _without_command(path.read_bytes()) == _without_command(derived.read_bytes())


def _without_command(card: bytes) -> list[bytes]:
    lines = card.splitlines()
    told = [line.startswith(GENERATED_BY.encode()) for line in lines]
    return [line for k, line in enumerate(lines) if not told[k] or k != told.index(True)]
