"""Frozen batch normalisation: running statistics are kept for the last part of a training.

In training a layer subtracts its batch's mean, which varies between batches: of B clouds that lie s apart, by s /
sqrt(B). Where clouds are not centred, as the paper's are not, this hides the tool's position by that much (128 clouds
over 17 cm of depth: 15 mm). Fixed statistics avoid it.
"""

from __future__ import annotations

from torch import nn


def freeze_batchnorm(net: nn.Module, frozen: bool) -> None:
    """Switch layers of batch normalisation between running statistics, kept, and their batch's.

    Their weights learn either way.

    Args:
        net: The network.
        frozen: Whether the running statistics are used and kept.
    """
    for module in net.modules():
        if isinstance(module, nn.BatchNorm1d):
            module.train(not frozen)
