"""Generation on a Ray cluster (the `cluster` extra). All machines must see the output folder under the same path."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator
from typing import Any

from toolee_robot.errors import TooleeError, UserError
from toolee_robot.perception.dataset.spec import SceneJob


def on_ray(make: Callable[[SceneJob], SceneJob], jobs: list[SceneJob], workers: int) -> Generator[SceneJob]:
    """Run make(job) for every job on the cluster that RAY_ADDRESS names, or on one started here; yields them as they
    are done. At most `workers` run at a time, each on one core."""
    try:
        import ray
    except ImportError as error:
        raise UserError("--cluster ray needs Ray: python -m pip install 'toolee_robot[cluster]'") from error
    from toolee_robot.perception.dataset.generate import ONE_THREAD

    started = not ray.is_initialized()
    if started:
        # Without a cluster to join: one on this machine, that nobody else can reach.
        where: dict[str, Any] = (
            {} if "RAY_ADDRESS" in os.environ else {"address": "local", "_node_ip_address": "127.0.0.1"}
        )
        environment = {"env_vars": ONE_THREAD}
        ray.init(include_dashboard=False, log_to_driver=False, runtime_env=environment, **where)
    try:
        remote: Any = ray.remote(num_cpus=1, max_retries=2)(make_one)
        waiting = list(reversed(jobs))
        running: list[Any] = []
        while waiting or running:
            while waiting and len(running) < workers:
                running.append(remote.remote(make, waiting.pop()))
            finished, running = ray.wait(running, num_returns=1)
            try:
                yield ray.get(finished[0])
            except ray.exceptions.RayError as error:
                raise TooleeError(f"a Ray task failed: {error}; run the same command again, it resumes") from error
    finally:
        if started:
            ray.shutdown()


def make_one(make: Callable[[SceneJob], SceneJob], job: SceneJob) -> SceneJob:
    """What a Ray task does."""
    return make(job)
