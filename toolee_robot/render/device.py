"""The devices that kernels run on: "cpu", or a GPU of NVIDIA's as "cuda"."""

from __future__ import annotations

import ctypes
import ctypes.util
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import lru_cache
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from toolee_robot.errors import UserError

DeviceArray = Any
"""A `warp.array`: on "cpu" it and its `numpy()` are the same memory."""
_BLOCKING_SYNC = 4
"""CU_CTX_SCHED_BLOCKING_SYNC"""


@lru_cache(maxsize=1)
def _start() -> None:
    wp.config.log_level = wp.LOG_WARNING
    # Warp's library warns of a missing driver whoever asks for the processor.
    with _no_stderr() if ctypes.util.find_library("cuda") is None else nullcontext():
        wp.init()  # type: ignore[no-untyped-call]


@contextmanager
def _no_stderr() -> Iterator[None]:
    sys.stderr.flush()
    before, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(before, 2)
        os.close(before)
        os.close(nowhere)


@lru_cache
def checked(device: str) -> str:
    """The device's name, when it can be used. Raises UserError when it cannot."""
    _start()
    if device not in ("cpu", "cuda"):
        raise UserError(f"--device {device}: choose cpu or cuda")
    if device == "cuda":
        if not wp.is_cuda_available():
            raise UserError("--device cuda: Warp finds no GPU of NVIDIA's, or too old a driver; choose cpu")
        _take_gpu(os.getpid() % wp.get_cuda_device_count())
    return device


def _take_gpu(number: int) -> None:
    """Make "cuda" that GPU, and let this process sleep while it waits for it: others need the core."""
    # Only before the first use; Warp has no call for it.
    ctypes.CDLL("libcuda.so.1").cuDevicePrimaryCtxSetFlags(number, _BLOCKING_SYNC)
    wp.set_device(f"cuda:{number}")


def put(values: NDArray[Any] | DeviceArray, dtype: Any, device: str) -> DeviceArray:
    """An array on the device; on "cpu" without a copy where its memory can be shared."""
    if isinstance(values, wp.array):
        return values
    return wp.array(np.ascontiguousarray(values), dtype=dtype, device=device, copy=device != "cpu")


def rows_of(struct: Any, rows: Sequence[tuple[Any, ...]]) -> NDArray[Any]:
    """Those values of the fields of a `warp.struct`, as `put` takes them."""
    return np.array(rows, _layout(struct))


@lru_cache
def _layout(struct: Any) -> np.dtype[Any]:
    layout: np.dtype[Any] = struct.numpy_dtype()
    return layout


def empty(shape: int | tuple[int, ...], dtype: Any, device: str) -> DeviceArray:
    """An array on the device, its values undefined."""
    return wp.empty(shape, dtype=dtype, device=device)


def launch(kernel: Any, shape: int | tuple[int, ...], *arguments: Any, device: str) -> None:
    """Run a kernel for each index of `shape`; nothing at all where there is none."""
    if np.prod(shape) > 0:
        wp.launch(kernel, dim=shape, inputs=arguments, device=device)
