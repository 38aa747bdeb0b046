"""Calls on a Ray cluster (the `cluster` extra). Files that they write are on a folder that all machines share."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import socket
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from typing import Any, TypeVar

from toolee_robot.errors import TooleeError, UserError, words_of
from toolee_robot.runtime.clock import is_loopback
from toolee_robot.runtime.processes import ONE_THREAD

Item = TypeVar("Item")
Result = TypeVar("Result")

_PATIENCE = 5.0
"""[s] A cluster's head that takes no connection for so long is not there; Ray itself would wait for minutes."""
_NO_CLUSTER = "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"
"""What makes Ray take the loopback address for its own (and listen there alone) is its import with this at 0, on any
system; an address given to `ray.init` does not."""


def on_ray(call: Callable[[Item], Result], items: Sequence[Item], count: int | None) -> Generator[Result]:
    """Call a function for every item on a Ray cluster, see `joined`.

    A call whose process or machine dies is repeated up to twice.

    Args:
        call: The function.
        items: The items.
        count: Largest number of calls at a time, of which each uses a core; None for the cluster's cores.

    Yields:
        The results, in the order in which they are finished.

    Raises:
        TooleeError: A call failed; errors of `call` that are of this class pass as they are.
        UserError: Ray or the cluster is missing.
    """
    with joined() as ray:
        remote = ray.remote(num_cpus=1, max_retries=2)(call_one)
        most = max(1, int(ray.cluster_resources().get("CPU", 1))) if count is None else count
        waiting = list(reversed(items))
        running: list[Any] = []
        while waiting or running:
            while waiting and len(running) < most:
                running.append(remote.remote(call, waiting.pop()))
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


def call_one(call: Callable[[Item], Result], item: Item) -> Result:
    """Call the function for one item; the body of a Ray task.

    Args:
        call: The function.
        item: The item.

    Returns:
        The function's result.
    """
    return call(item)


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
    terminate = signal.getsignal(signal.SIGTERM)
    try:
        ray.init(log_to_driver=False, logging_level=logging.ERROR, runtime_env={"env_vars": ONE_THREAD}, **where)
    except (ConnectionError, RuntimeError, ValueError) as error:
        what = "start a Ray cluster here" if address is None else f"join the Ray cluster at RAY_ADDRESS={address}"
        raise UserError(f"cannot {what}: {error}") from error
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, terminate)  # Ray's own handler would end the process at once
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
            f"no Ray cluster answers at RAY_ADDRESS={address} ({words_of(error)}): start one there (ray start --head), "
            "or unset RAY_ADDRESS to use this machine alone"
        ) from error
