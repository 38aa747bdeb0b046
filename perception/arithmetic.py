"""How the networks compute on a processor: in bfloat16 where it has matrix units for that (Intel's AMX, servers from
2023 on), which halves the time of an image; in float32 elsewhere. Both networks are trained in bfloat16."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

import torch
from torch import nn
from torch.nn.utils.fusion import fuse_conv_bn_eval


def bfloat16_pays(device: torch.device) -> bool:
    """Whether the device is a processor with matrix units for bfloat16. Without them it was not tried."""
    return device.type == "cpu" and _matrix_units()


@cache
def _matrix_units() -> bool:
    # Older releases of torch cannot tell.
    capabilities: dict[str, object] = getattr(torch.cpu, "get_capabilities", dict)()
    return bool(capabilities.get("amx_bf16", False))


def fold_normalisation(network: nn.Module) -> None:
    """Fold each batch normalisation that follows a convolution in a sequence into that, in place, for inference."""
    for module in list(network.modules()):
        if isinstance(module, nn.Sequential):
            for i in range(len(module) - 1):
                conv, norm = module[i], module[i + 1]
                if isinstance(conv, nn.Conv2d) and isinstance(norm, nn.BatchNorm2d):
                    module[i], module[i + 1] = fuse_conv_bn_eval(conv, norm), nn.Identity()


def in_bfloat16(network: nn.Module) -> None:
    """Keep the weights of its products in bfloat16, in place: under `torch.autocast` each call would convert them."""
    for module in network.modules():
        if isinstance(module, nn.Linear | nn.Conv2d | nn.ConvTranspose2d):
            module.to(torch.bfloat16)


@contextmanager
def one_thread() -> Iterator[None]:
    """With one of torch's threads: for what takes so little that others gain nothing, and make it wait where they are
    busy elsewhere."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
