"""Generate a data set on several processes; the same bytes for any number of them.

python -m toolee_robot.perception.dataset.generate data/train --size 4096 --seed 1 --workers 4
python -m toolee_robot.perception.dataset.generate data/test --size 512 --seed 2 --split test
"""

from __future__ import annotations

import argparse
import contextlib
import json
import multiprocessing
import os
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from toolee_robot.errors import TooleeError, UserError
from toolee_robot.perception.dataset.bodies import forget_tools
from toolee_robot.perception.dataset.example import BLOCK, make_example
from toolee_robot.perception.dataset.storage import shard_path, write_shard


def generate(
    out: Path,
    size: int,
    seed: int,
    workers: int = 1,
    start: int = 0,
    split: str = "train",
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Write examples start .. start + size - 1 of data set `seed` into the folder `out`, one shard for each 64.

    start: a multiple of 64, so that runs can be joined. Shards that exist already are kept. split: "train" or "test"
    (held-out tools). progress(done, total) is called after each shard. A `dataset.json` says what is there.
    """
    if size < 1 or start < 0 or start % BLOCK or workers < 1 or split not in ("train", "test"):
        raise UserError(
            f"size and workers must be positive, start a multiple of {BLOCK} and split train or test; "
            f"got size {size}, workers {workers}, start {start}, split {split!r}"
        )
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot make the folder {out}: {error}") from error
    description = {"seed": seed, "split": split, "examples_per_shard": BLOCK}
    about = out / "dataset.json"
    if about.exists() and json.loads(about.read_text()) != description:
        raise UserError(f"{out} holds another data set ({about.read_text().strip()}): choose an empty folder")
    about.write_text(json.dumps(description) + "\n")
    last = start + size
    jobs = [(first, min(first + BLOCK, last)) for first in range(start, last, BLOCK)]
    todo = [job for job in jobs if not shard_path(out, job[0] // BLOCK).exists()]
    done = len(jobs) - len(todo)
    work = partial(_make_shard, out, seed, split)
    if workers == 1:
        for job in todo:
            work(job)
            done += 1
            if progress is not None:
                progress(done, len(jobs))
        return
    # Fresh processes: a fork would inherit embree's threads in an undefined state.
    with multiprocessing.get_context("spawn").Pool(workers, _use_one_core) as pool:
        for _ in pool.imap_unordered(work, todo):
            done += 1
            if progress is not None:
                progress(done, len(jobs))


def _make_shard(out: Path, seed: int, split: str, job: tuple[int, int]) -> None:
    first, last = job
    write_shard(shard_path(out, first // BLOCK), [make_example(seed, i, split) for i in range(first, last)])
    forget_tools()


def _use_one_core() -> None:
    """Pin this worker: embree and BLAS would each start a thread per core, and the workers fight over them."""
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[variable] = "1"
    identity = multiprocessing.current_process()._identity
    if hasattr(os, "sched_setaffinity") and identity:
        cores = sorted(os.sched_getaffinity(0))
        with contextlib.suppress(OSError):  # some containers forbid it: then the workers are only slower
            os.sched_setaffinity(0, {cores[(identity[0] - 1) % len(cores)]})


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="folder for the shards")
    parser.add_argument("--size", type=int, required=True, help="number of examples")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--start", type=int, default=0, help="first example, a multiple of 64")
    parser.add_argument("--split", choices=("train", "test"), default="train", help="test: held-out tools")
    options = parser.parse_args()
    began = time.monotonic()

    def report(done: int, total: int) -> None:
        rate = done * BLOCK / (time.monotonic() - began)
        print(f"{done}/{total} shards, {rate:.1f} examples/s", flush=True)

    try:
        generate(options.out, options.size, options.seed, options.workers, options.start, options.split, report)
    except TooleeError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2 if isinstance(error, UserError) else 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
