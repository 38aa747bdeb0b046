"""A function recorded once as a CUDA graph and replayed: one launch instead of some hundreds, one synchronisation."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

Function = Callable[..., tuple[Tensor, ...]]
_WARM_UP = 3


@dataclass(frozen=True, eq=False)
class _Recording:
    """A recorded graph with its buffers.

    Attributes:
        graph: The graph.
        inputs: Input buffers in pinned host memory.
        outputs: Output buffers in pinned host memory.
        held: Input buffers on the device.
    """

    graph: torch.cuda.CUDAGraph
    inputs: tuple[Tensor, ...]
    outputs: tuple[Tensor, ...]
    held: tuple[Tensor, ...]


class CudaGraphRunner:
    """A function of tensors, replayed as a CUDA graph, with the same results.

    Inputs and outputs are on the host; the copies to and from the device are part of the graph. There is one recording
    per set of input shapes. The function must not depend on values (no branch on a tensor, no copy to the host). Calls
    are serialised: a recording has one set of buffers.

    Args:
        function: The function, of tensors on the device.
        device: CUDA device.
    """

    def __init__(self, function: Function, device: torch.device) -> None:
        self._function, self._device = function, device
        self._recordings: dict[tuple[torch.Size, ...], _Recording] = {}
        self._lock = threading.Lock()

    def __call__(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        """The function's outputs on the host, for inputs on the host."""
        key = tuple(x.shape for x in inputs)
        with self._lock, torch.cuda.device(self._device):
            if key not in self._recordings:
                self._recordings[key] = self._record(inputs)
            recording = self._recordings[key]
            for buffer, x in zip(recording.inputs, inputs, strict=True):
                buffer.copy_(x)
            recording.graph.replay()
            torch.cuda.current_stream().synchronize()
            return tuple(x.clone() for x in recording.outputs)

    def _record(self, inputs: tuple[Tensor, ...]) -> _Recording:
        given = tuple(x.cpu().clone().pin_memory() for x in inputs)
        held = tuple(x.to(self._device) for x in given)
        side = torch.cuda.Stream()  # type: ignore[no-untyped-call]
        side.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(side):
            for _ in range(_WARM_UP):
                results = self._function(*held)
        torch.cuda.current_stream().wait_stream(side)
        taken = tuple(torch.empty_like(x, device="cpu").pin_memory() for x in results)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            for there, here in zip(held, given, strict=True):
                there.copy_(here, non_blocking=True)
            for here, result in zip(taken, self._function(*held), strict=True):
                here.copy_(result, non_blocking=True)
        return _Recording(graph, given, taken, held)
