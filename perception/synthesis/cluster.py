"""Generation on a Ray cluster (the `cluster` extra). All machines must see the output folder under the same path."""

from __future__ import annotations

import contextlib
import logging
import os
import socket
from collections.abc import Callable, Generator, Iterator
from typing import Any

from toolee_robot.errors import TooleeError, UserError
from toolee_robot.perception.dataset.parallel import ONE_THREAD
from toolee_robot.perception.dataset.spec import SceneJob
from toolee_robot.runtime.clock import is_loopback

_PATIENCE = 5.0
"""[s] A cluster's head that takes no connection for so long is not there; Ray itself would wait for minutes."""
_NO_CLUSTER = "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"
"""What makes Ray take the loopback address for its own (and listen there alone) is its import with this at 0, on any
system; an address given to `ray.init` does not."""


def on_ray(make: Callable[[SceneJob], SceneJob], jobs: list[SceneJob], workers: int) -> Generator[SceneJob]:
    """Run a function for every scene on a Ray cluster, see `joined`.

    A call whose process dies is repeated up to twice.

    Args:
        make: The function.
        jobs: The scenes.
        workers: Largest number of calls at a time; each uses one core.

    Yields:
        The results, in the order in which they are finished.

    Raises:
        TooleeError: A call failed; errors of `make` that are of this class pass as they are.
        UserError: Ray or the cluster is missing.
    """
    with joined() as ray:
        remote = ray.remote(num_cpus=1, max_retries=2)(make_one)
        waiting = list(reversed(jobs))
        running: list[Any] = []
        while waiting or running:
            while waiting and len(running) < workers:
                running.append(remote.remote(make, waiting.pop()))
            finished, running = ray.wait(running, num_returns=1)
            try:
                yield ray.get(finished[0])
            except ray.exceptions.RayError as error:
                cause = getattr(error, "cause", error)
                if isinstance(cause, TooleeError):
                    raise cause from error
                raise TooleeError(
                    f"a Ray task failed: {type(cause).__name__}: {cause}; run the same command again, it resumes"
                ) from error


def make_one(make: Callable[[SceneJob], SceneJob], job: SceneJob) -> SceneJob:
    """Call the function for one scene; the body of a Ray task.

    Args:
        make: The function.
        job: The scene.

    Returns:
        The function's result.
    """
    return make(job)


@contextlib.contextmanager
def joined() -> Iterator[Any]:
    """Connect to a Ray cluster: the one that RAY_ADDRESS names, or one that is started here.

    A cluster started here listens on the loopback address alone and ends with the context. An existing connection is
    used and kept.

    Yields:
        The module ray, connected.

    Raises:
        UserError: Ray or the cluster is missing.
    """
    address = os.environ.get("RAY_ADDRESS")
    if address is None:
        os.environ.setdefault(_NO_CLUSTER, "0")
    try:
        import ray
    except ImportError as error:
        raise UserError(
            "--cluster ray needs Ray: run `python -m pip install -e '.[cluster]'` in the repository",
            code="user.missing_package",
        ) from error
    if ray.is_initialized():
        yield ray
        return
    _connect(ray, address)
    try:
        yield ray
    finally:
        ray.shutdown()


def _connect(ray: Any, address: str | None) -> None:
    where: dict[str, Any] = {}
    if address is None:
        where = {"address": "local", "include_dashboard": False}
    else:
        _knock(address)
    try:
        ray.init(log_to_driver=False, logging_level=logging.ERROR, runtime_env={"env_vars": ONE_THREAD}, **where)
    except (ConnectionError, RuntimeError, ValueError) as error:
        what = "start a Ray cluster here" if address is None else f"join the Ray cluster at RAY_ADDRESS={address}"
        raise UserError(f"cannot {what}: {error}") from error
    if address is None and not is_loopback(ray.util.get_node_ip_address()):
        ray.shutdown()
        raise UserError(f"Ray would listen to the whole network: set {_NO_CLUSTER}=0 before it is imported")


def _knock(address: str) -> None:
    """Raises UserError where nothing listens at host:port or ray://host:port; other addresses are Ray's to judge."""
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if not (colon and port.isdecimal()):
        return
    try:
        socket.create_connection((host, int(port)), _PATIENCE).close()
    except (OSError, OverflowError) as error:
        raise UserError(
            f"no Ray cluster answers at RAY_ADDRESS={address} ({error}): start one there (ray start --head), or unset "
            "RAY_ADDRESS to use this machine alone"
        ) from error
