"""Parallel generation of a data set on processes; the result does not depend on their number.

An interrupted run resumes when it is started again.
"""

from __future__ import annotations

import contextlib
import os
import resource
import shutil
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from toolee_robot.errors import UserError, words_of
from toolee_robot.perception.offline.dataset.catalogue import FIRST_KINDS, CustomMesh
from toolee_robot.perception.offline.dataset.index_files import Summary, finish, is_finished
from toolee_robot.perception.offline.dataset.instances import tool_path, write_models
from toolee_robot.perception.offline.dataset.records import SUMS, json_by_line, read_json
from toolee_robot.perception.offline.dataset.scenes import write_scene
from toolee_robot.perception.offline.dataset.spec import DESCRIPTION, SPLITS, DatasetSpec, SceneJob
from toolee_robot.perception.offline.processes import check_workers, on_processes
from toolee_robot.perception.offline.synthesis.bodies import forget_tools
from toolee_robot.perception.offline.synthesis.example import examples_of
from toolee_robot.render.device import checked
from toolee_robot.runtime.files import write_atomic
from toolee_robot.tools import TOOL_SPECS

Progress = Callable[[int, int], None]
"""Called with the numbers of finished and of all examples."""


def generate(
    spec: DatasetSpec,
    out: Path,
    workers: int = 1,
    progress: Progress | None = None,
    custom_tools: Sequence[CustomMesh] = (),
) -> bool:
    """Generate a data set; scenes that exist are kept.

    Args:
        spec: Specification of the data set.
        out: Folder of the data set.
        workers: Number of processes.
        progress: Called after each scene.
        custom_tools: Meshes of `spec.tools`.

    Returns:
        False if the data set was already complete.

    Raises:
        UserError: An option is invalid, `out` holds something else, or the device is not available.
        TooleeError: A worker process died.
    """
    check_workers(workers)
    checked(spec.device)
    begin(spec, out, custom_tools)
    if is_finished(out):
        return False
    jobs = spec.jobs()
    todo = [job for job in jobs if not (job.folder(out) / SUMS).exists()]
    done = spec.size - sum(job.last - job.first for job in todo)
    if progress is not None:
        progress(done, spec.size)
    waiting = deque(jobs)
    summary = Summary(spec, out)
    with contextlib.closing(on_processes(partial(make_scene_folder, spec, out.resolve()), todo, workers)) as made:
        for job in made:
            done += job.last - job.first
            if progress is not None:
                progress(done, spec.size)
            # A shared folder may show a scene with a delay: add it when its files are visible here.
            while waiting and (waiting[0].folder(out) / SUMS).exists():
                summary.add(waiting.popleft())
    for job in waiting:
        summary.add(job)
    summary.write(out)
    _clear(out)  # workers of a killed run may still have written files
    finish(out)
    return True


def begin(spec: DatasetSpec, out: Path, custom_tools: Sequence[CustomMesh] = ()) -> None:
    """Create or check the folder `out`, write the custom meshes, and remove incomplete scenes of an interrupted run.

    Args:
        spec: Specification of the data set.
        out: Its folder.
        custom_tools: The custom meshes.

    Raises:
        UserError: `out` cannot be created or holds something else.
    """
    try:
        for split in SPLITS:
            (out / split).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot make the folder {out}: {words_of(error)}") from error
    path = out / DESCRIPTION
    wanted = spec.to_json()
    if path.exists():
        there = read_json(path)
        if there != wanted:
            differ = sorted(k for k in {*there, *wanted} if there.get(k) != wanted.get(k))
            remedy = "choose an empty folder"
            if differ == ["kinds"] and (kinds := there.get("kinds", FIRST_KINDS)) <= len(TOOL_SPECS):
                remedy += f", or give --kinds {kinds} to go on with it"
            raise UserError(
                f"{out} holds another data set (other {', '.join(differ)}): {remedy}", code="user.other_data_set"
            )
    elif any(p.name not in SPLITS for p in out.iterdir()) or any(any((out / s).iterdir()) for s in SPLITS):
        raise UserError(f"{out} is not empty and no data set: choose another folder", code="user.folder_not_empty")
    else:
        write_atomic(path, json_by_line(wanted))
    _clear(out)
    for tool in custom_tools:
        path = tool_path(out, tool.record.name)
        path.parent.mkdir(exist_ok=True)
        write_atomic(path, tool.ply)
    for split in SPLITS:
        for scene in (out / split).glob("[0-9]*"):
            if not (scene / SUMS).exists():
                shutil.rmtree(scene)


def _clear(out: Path) -> None:
    """Remove partial files of killed processes."""
    for left in [*out.glob(".*.part"), *out.glob("*/.*.part")]:
        if left.is_dir():
            # Rename before deletion: a worker that still writes there must fail rather than complete a partial scene.
            with contextlib.suppress(FileNotFoundError):
                shutil.rmtree(left.rename(left.with_suffix(f".{os.getpid()}.gone.part")), ignore_errors=True)
        else:
            left.unlink(missing_ok=True)


def make_scene_folder(spec: DatasetSpec, out: Path, job: SceneJob) -> SceneJob:
    """Write one scene and the models of its tools.

    Args:
        spec: Specification of the data set.
        out: Folder of the data set.
        job: The scene.

    Returns:
        The scene.
    """
    catalogue = spec.catalogue(out)
    examples = examples_of(spec, job.split, job.first, job.last, catalogue)
    write_scene(job.folder(out), examples, partial(write_models, out, catalogue), catalogue)
    forget_tools()
    return job


@dataclass(frozen=True)
class Cost:
    """Cost of generating examples, including start and end of the run.

    Attributes:
        examples: Number of generated examples.
        per_second: Examples per second.
        cpu_ms: CPU time of the worker processes per example [ms].
        worker_mb: Largest memory of a worker process [MB].
    """

    examples: int
    per_second: float
    cpu_ms: float
    worker_mb: float

    @staticmethod
    def of_workers(examples: int, seconds: float) -> Cost | None:
        """Measure the cost from the ended child processes.

        Args:
            examples: Number of examples that they made.
            seconds: Time on the wall [s].

        Returns:
            The cost; None if nothing was generated.
        """
        if examples == 0:
            return None
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu = used.ru_utime + used.ru_stime
        return Cost(examples, examples / seconds, 1e3 * cpu / examples, used.ru_maxrss / 1024)
