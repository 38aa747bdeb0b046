"""Where networks compute, and in which precision: on a CPU bfloat16 where it has matrix units for it, else float32.

Matrix units (Intel AMX, servers since 2023) halve the time per image. Both networks are trained in bfloat16.

`CudaGraph`, a function recorded once and replayed: one launch instead of some hundreds, one synchronisation.
"""

from __future__ import annotations

import copy
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import Final

import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from toolee_robot.errors import UserError

_PACKS: Final = (
    hasattr(torch.ops.mkldnn, "_linear_pointwise")
    and hasattr(torch.ops.mkldnn, "_is_mkldnn_bf16_supported")
    and torch.ops.mkldnn._is_mkldnn_bf16_supported()
)
"""Whether this release of torch has the operator for products with packed weights that its own compiler uses, and this
CPU the instructions for it (AVX-512 or AVX-NE-CONVERT)."""


def torch_device(name: torch.device | str) -> torch.device:
    """A device by its name.

    Args:
        name: Name, such as "cpu" or "cuda:1".

    Returns:
        The device.

    Raises:
        UserError: There is none of this name here.
    """
    try:
        device = torch.device(name)
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:
        words = str(error).splitlines()[0]
        raise UserError(f"nothing computes on {name} here ({words}): give cpu", code="user.device") from error
    return device


def prefers_bfloat16(device: torch.device) -> bool:
    """Whether a device is a CPU with matrix units for bfloat16. CPUs without them use float32."""
    return device.type == "cpu" and _matrix_units()


@cache
def _matrix_units() -> bool:
    # Older releases of torch have no such query.
    capabilities: dict[str, object] = getattr(torch.cpu, "get_capabilities", dict)()
    return bool(capabilities.get("amx_bf16", False))


def fold_normalisation(network: nn.Module) -> None:
    """Fold each batch normalisation that follows a convolution in a sequence into it, in place, for inference."""
    for module in list(network.modules()):
        if isinstance(module, nn.Sequential):
            for i in range(len(module) - 1):
                conv, norm = module[i], module[i + 1]
                if isinstance(conv, nn.Conv2d) and isinstance(norm, nn.BatchNorm2d):
                    module[i], module[i + 1] = fuse_conv_bn_eval(conv, norm), nn.Identity()


def in_bfloat16(network: nn.Module) -> None:
    """Convert a network's products to bfloat16, in place, for inference on a CPU.

    `torch.autocast` alone would convert the weights in each call.
    """
    for module in list(network.modules()):
        if isinstance(module, nn.Conv2d | nn.ConvTranspose2d):
            module.to(torch.bfloat16)
        for name, child in list(module.named_children()):
            if isinstance(child, nn.Linear):
                setattr(module, name, Bfloat16Linear(child))


class Bfloat16Linear(nn.Module):
    """A linear layer in bfloat16, for inputs of any floating type.

    Its weights are stored in oneDNN's packed layout. `nn.Linear` packs them in each call, a quarter of its time for a
    few hundred rows; the results are the same.

    Args:
        layer: The layer whose weights it takes.
    """

    def __init__(self, layer: nn.Linear) -> None:
        super().__init__()
        layer = copy.deepcopy(layer).requires_grad_(False).to(torch.bfloat16)
        self._packed = _PACKS
        self._weight = torch.ops.mkldnn._reorder_linear_weight(layer.weight, None) if self._packed else layer.weight
        self._bias = layer.bias

    def forward(self, x: Tensor) -> Tensor:
        """Map x (..., in) of any floating type to (..., out) in bfloat16."""
        x = x.to(torch.bfloat16)
        if not self._packed:
            return nn.functional.linear(x, self._weight, self._bias)
        result: Tensor = torch.ops.mkldnn._linear_pointwise(x, self._weight, self._bias, "none", [], "")
        return result


@contextmanager
def single_thread() -> Iterator[None]:
    """Run the block with a single torch thread.

    For work too small to gain from other threads, which may have to wait for busy cores.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


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
