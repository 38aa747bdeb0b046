"""Batch normalisation that stops asking its batch: its statistics are kept for the last part of a training.

In training a layer subtracts its batch's mean, which is another in every batch: of B clouds that lie s apart it is off
by s / sqrt(B). Where clouds are not centred, as the paper's are not, this hides where the tool is by that much (128 of
them over 17 cm of depth: 15 mm), and the network learns that it cannot know. With statistics that stay it can.
"""

from __future__ import annotations

from torch import nn


def freeze_batchnorm(net: nn.Module, frozen: bool) -> None:
    """Layers of batch normalisation take their running statistics, and keep them, where frozen, and otherwise their
    batch's. Their weights learn either way."""
    for module in net.modules():
        if isinstance(module, nn.BatchNorm1d):
            module.train(not frozen)
