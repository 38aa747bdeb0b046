"""Labelled images: the trainings' view of a data set, and its storage as bytes on a device."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

_CHUNK = 512
"""Images copied to the device at a time."""


class SegmentationImages(Protocol):
    """The trainings' view of a data set: arrays of N images of one size.

    Attributes:
        rgb: (N, H, W, 3) uint8.
        depth_mm: (N, H, W) uint16 [mm], 0 where unknown.
        intrinsics: fx, fy, cx, cy, (N, 4) [px].
        ee: Id of the end effector at each pixel, 0 for none, (N, H, W) uint8.
        tool: Id of the tool at each pixel, 0 for none, (N, H, W) uint8.
        categories: Class index (1..4, the order of `Category`) of EE ids 1..E, 0 where there is none, (N, E) uint8.
    """

    @property
    def rgb(self) -> NDArray[np.uint8]: ...

    @property
    def depth_mm(self) -> NDArray[np.uint16]: ...

    @property
    def intrinsics(self) -> NDArray[np.float64]: ...

    @property
    def ee(self) -> NDArray[np.uint8]: ...

    @property
    def tool(self) -> NDArray[np.uint8]: ...

    @property
    def categories(self) -> NDArray[np.uint8]: ...


class DeviceStore:
    """A data set, or one rank's part of it, as bytes on the device.

    It may grow: of its M rows the first `len` are images.

    Args:
        device: torch device.
        tools: Whether to store the ids of tools, too.
        expected: Number of images that will come, for which memory is taken with the first ones. Without it, and beyond
            it, the rows are copied into larger ones, and for that time need 2.5 times their memory.

    Attributes:
        rgb: (M, H, W, 3) uint8.
        maps: Ids of EE and, if `tools`, of tool, (M, 1 or 2, H, W) uint8.
        focal: Focal length, (M,) [px].
    """

    def __init__(self, device: torch.device, tools: bool, expected: int = 0) -> None:
        self.device = device
        self._expected = expected
        self._count = 0
        self.rgb = torch.empty((0, 0, 0, 3), dtype=torch.uint8, device=device)
        self._millimetres = torch.empty((0, 0, 0), dtype=torch.int16, device=device)
        self.maps = torch.empty((0, 2 if tools else 1, 0, 0), dtype=torch.uint8, device=device)
        self.focal = torch.empty(0, device=device)

    def __len__(self) -> int:
        return self._count

    def depth(self, which: Tensor) -> Tensor:
        """Depth (B, H, W) float32 [m], 0 where unknown, of the images `which` (B,)."""
        return self._millimetres[which].float() / 1000.0

    def extend(self, more: SegmentationImages) -> None:
        """Add more images, all of one size."""
        first, end = self._count, self._count + len(more.rgb)
        if end > len(self.rgb):
            # Grow geometrically, so that not every scene copies all stored images.
            capacity = max(end, self._expected, 3 * first // 2)
            size = more.rgb.shape[1:3]
            self.rgb = grown(self.rgb, (capacity, *size, 3))
            self._millimetres = grown(self._millimetres, (capacity, *size))
            self.maps = grown(self.maps, (capacity, self.maps.shape[1], *size))
            self.focal = grown(self.focal, (capacity,))
        for start in range(0, len(more.rgb), _CHUNK):
            part = slice(start, min(start + _CHUNK, len(more.rgb)))
            place = slice(first + part.start, first + part.stop)
            self.rgb[place] = torch.from_numpy(more.rgb[part]).to(self.device)
            millimetres = np.minimum(more.depth_mm[part], np.iinfo(np.int16).max).astype(np.int16)
            self._millimetres[place] = torch.from_numpy(millimetres).to(self.device)
            for k, ids in enumerate((more.ee, more.tool)[: self.maps.shape[1]]):
                self.maps[place, k] = torch.from_numpy(ids[part]).to(self.device)
        focal = np.sqrt(more.intrinsics[:, 0] * more.intrinsics[:, 1])
        self.focal[first:end] = torch.from_numpy(focal.astype(np.float32)).to(self.device)
        self._count = end


def grown(old: Tensor, shape: tuple[int, ...]) -> Tensor:
    """Grow a tensor.

    Args:
        old: The tensor.
        shape: The new shape, nowhere smaller.

    Returns:
        A tensor of that shape: the old one in its first corner, zero elsewhere.
    """
    new = old.new_zeros(shape)
    if old.numel():
        new[tuple(slice(n) for n in old.shape)] = old
    return new
