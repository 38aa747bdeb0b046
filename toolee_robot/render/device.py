"""Compute devices of the kernels: "cpu", or "cuda" for an NVIDIA GPU."""

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
"""A `warp.array`; on "cpu" it shares its memory with its `numpy()`."""
_BLOCKING_SYNC = 4
"""CU_CTX_SCHED_BLOCKING_SYNC"""


@lru_cache(maxsize=1)
def _start() -> None:
    wp.config.log_level = wp.LOG_WARNING
    # Without a CUDA driver Warp prints a warning, even if only the CPU is used.
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
    """Initialize a device.

    Args:
        device: "cpu" or "cuda".

    Returns:
        The name of the device.

    Raises:
        UserError: The name is unknown, or there is no usable GPU.
    """
    _start()
    if device not in ("cpu", "cuda"):
        raise UserError(f"--device {device}: choose cpu or cuda")
    if device == "cuda":
        if not wp.is_cuda_available():
            raise UserError("--device cuda: Warp finds no NVIDIA GPU, or its driver is too old; choose cpu")
        _take_gpu(os.getpid() % wp.get_cuda_device_count())
    return device


def _take_gpu(number: int) -> None:
    """Select a GPU as "cuda"; this process sleeps while it waits for the GPU, which leaves the core to others."""
    # Must precede the first use of the GPU; Warp has no function for it.
    ctypes.CDLL("libcuda.so.1").cuDevicePrimaryCtxSetFlags(number, _BLOCKING_SYNC)
    wp.set_device(f"cuda:{number}")


def put(values: NDArray[Any] | DeviceArray, dtype: Any, device: str) -> DeviceArray:
    """Bring values onto the device; not copied on "cpu" if the memory can be shared.

    Args:
        values: The values; an array that is on the device already is returned as it is.
        dtype: Warp type of the elements.
        device: Warp device.

    Returns:
        The array on the device.
    """
    if isinstance(values, wp.array):
        return values
    return wp.array(np.ascontiguousarray(values), dtype=dtype, device=device, copy=device != "cpu")


def rows_of(struct: Any, rows: Sequence[tuple[Any, ...]]) -> NDArray[Any]:
    """Make a structured array of a `warp.struct`, for `put`.

    Args:
        struct: The struct.
        rows: Values of its fields, one tuple per element.

    Returns:
        The array, (N,).
    """
    return np.array(rows, _layout(struct))


@lru_cache
def _layout(struct: Any) -> np.dtype[Any]:
    layout: np.dtype[Any] = struct.numpy_dtype()
    return layout


def empty(shape: int | tuple[int, ...], dtype: Any, device: str) -> DeviceArray:
    """Allocate an uninitialised array on the device.

    Args:
        shape: Its shape.
        dtype: Warp type of the elements.
        device: Warp device.

    Returns:
        The array.
    """
    return wp.empty(shape, dtype=dtype, device=device)


def launch(kernel: Any, shape: int | tuple[int, ...], *arguments: Any, device: str) -> None:
    """Run a kernel for each index of a shape; an empty shape is a no-op.

    Args:
        kernel: The kernel.
        shape: The shape.
        *arguments: Arguments of the kernel, outputs last.
        device: Warp device.
    """
    if np.prod(shape) > 0:
        wp.launch(kernel, dim=shape, inputs=arguments, device=device)
