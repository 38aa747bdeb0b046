"""The mask refiner: segments each detected end effector again in an enlarged crop, and scores the new mask.

The detector's mask head works on features of an image at one size, in which small things have few pixels. This network
sees only a square of the image around one detection, always at the same size, with the detector's mask as a hint (as
Tang et al., "Look Closer to Segment Better", CVPR 2021, refine outlines), and every pixel's metric position: an end
effector's mask ends where the tool leaves a sphere of some centimetres.

Boxes are x0, y0, x1, y1 [px] of the image, pixel edges at integer coordinates.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from toolee_robot.end_effectors import Category
from toolee_robot.errors import AssetError
from toolee_robot.perception.detection.backbone import paste_one
from toolee_robot.perception.detection.detector import TOOL
from toolee_robot.perception.detection.instances import Instance, without_duplicates
from toolee_robot.perception.precision import fold_normalisation, in_bfloat16
from toolee_robot.perception.weight_files import WEIGHTS_DIR, load_into, load_weights
from toolee_robot.types import RgbdFrame

CELLS = 96
"""Cells per side of a square."""
CHANNELS = 8
"""Channels of a square; see `sample_squares`."""

_MARGIN = 1.7
_MIN_SIDE = 24.0
_METRES = 0.05
_MAX_DEPTH = 3.0
_NEAR_QUANTILE = 0.3
_EVERY = 3

MaskAt = Callable[[Tensor, Tensor], Tensor]
"""From columns and rows (N, CELLS, CELLS) int64 of an image's pixels to whether the mask holds them, bool."""


@dataclass(frozen=True)
class Squares:
    """N squares in images.

    Attributes:
        centre: (N, 2) [px].
        side: (N,) [px].
        turn: Rotation of the square's axes in the image, (N,) [rad].
        mirrored: -1 where the square is seen mirrored left to right, else 1, (N,).
    """

    centre: Tensor
    side: Tensor
    turn: Tensor
    mirrored: Tensor

    @classmethod
    def about(cls, boxes: Tensor) -> Squares:
        """Upright squares around the centres of boxes (N, 4), with a margin."""
        side = ((boxes[:, 2:] - boxes[:, :2]).amax(1) * _MARGIN).clamp(min=_MIN_SIDE)
        return cls((boxes[:, :2] + boxes[:, 2:]) / 2, side, torch.zeros_like(side), torch.ones_like(side))

    def mirrored_copy(self) -> Squares:
        """The same squares, mirrored left to right."""
        return Squares(self.centre, self.side, self.turn, -self.mirrored)

    def jittered(self) -> Squares:
        """Squares for training: shifted, scaled, rotated (half of them) and mirrored at random."""
        n, device = len(self.side), self.side.device
        shift = 0.05 * torch.randn((n, 2), device=device) * self.side[:, None]
        side = self.side * torch.exp(0.25 * (2 * torch.rand(n, device=device) - 1))
        turn = torch.where(torch.rand(n, device=device) < 0.5, 0.0, 2 * math.pi * torch.rand(n, device=device))
        mirrored = torch.where(torch.rand(n, device=device) < 0.5, -1.0, 1.0)
        return Squares(self.centre + shift, side, turn, mirrored)

    def boxes(self) -> Tensor:
        """Boxes (N, 4) of upright squares; they may reach beyond the image."""
        half = self.side[:, None] / 2
        return torch.cat([self.centre - half, self.centre + half], 1)

    def offsets(self) -> tuple[Tensor, Tensor]:
        """Offsets [px] of the cells' centres from the square's centre along its own axes.

        Returns:
            x (N, 1, CELLS) and y (N, CELLS, 1).
        """
        steps = (torch.arange(CELLS, device=self.side.device) + 0.5) / CELLS - 0.5
        span = steps * self.side[:, None]
        return span[:, None, :], span[:, :, None]

    def places(self) -> tuple[Tensor, Tensor]:
        """Image coordinates u, v (N, CELLS, CELLS) [px] of the cells' centres."""
        x, y = self.offsets()
        x = x * self.mirrored[:, None, None]
        cos, sin = torch.cos(self.turn)[:, None, None], torch.sin(self.turn)[:, None, None]
        u = self.centre[:, 0, None, None] + cos * x - sin * y
        v = self.centre[:, 1, None, None] + sin * x + cos * y
        return u, v


@dataclass(frozen=True)
class Images:
    """B images of one size.

    Attributes:
        rgb: (B, H, W, 3) uint8.
        depth: (B, H, W) [m], 0 where unknown.
        focal: (B,) [px].
    """

    rgb: Tensor
    depth: Tensor
    focal: Tensor


@torch.no_grad()
def sample_squares(images: Images, index: Tensor, squares: Squares, mask_at: MaskAt) -> tuple[Tensor, Tensor]:
    """Sample squares from images.

    Channels: colour in 0..255 (3); x, y, z from the square's centre and the depth under the mask, in units of 5 cm, x
    and y along the square's axes; whether the depth is known; the mask.

    Args:
        images: The images.
        index: Image of each square, (N,).
        squares: The squares.
        mask_at: Reads the detector's masks.

    Returns:
        (N, CHANNELS, CELLS, CELLS), and the cells' pixels (N, 2, CELLS, CELLS) int64: column and row, -1 beyond the
        image.
    """
    u, v = squares.places()
    height, width = images.rgb.shape[1:3]
    column, row = u.floor().long(), v.floor().long()
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    pixels = torch.where(inside[:, None], torch.stack([column, row], 1), -1)
    column, row = column.clamp(0, width - 1), row.clamp(0, height - 1)
    which = index[:, None, None]
    mask = mask_at(column, row) & inside
    z = images.depth[which, row, column]
    known = inside & (z > 0)
    reference = _depth_of(z, known, mask)[:, None, None]
    z = torch.where(known, z, reference)
    x, y = squares.offsets()
    scale = z / (images.focal[index][:, None, None] * _METRES)
    metres = torch.stack([x * scale, y * scale, (z - reference) / _METRES], 1).clamp(-_MAX_DEPTH, _MAX_DEPTH)
    colour = _colour(images.rgb, which, u, v) * inside[:, None]
    return torch.cat([colour, metres, known[:, None].float(), mask[:, None].float()], 1), pixels


def _depth_of(z: Tensor, known: Tensor, mask: Tensor) -> Tensor:
    """A low quantile of the known depths under the mask, (N,); of all known depths where the mask has none."""
    few = (slice(None), slice(1, None, _EVERY), slice(1, None, _EVERY))
    z, known, mask = z[few].flatten(1), known[few].flatten(1), (known & mask)[few].flatten(1)
    chosen = torch.where(mask.any(1, keepdim=True), mask, known)
    ordered = torch.where(chosen, z, torch.inf).sort(1)[0]
    count = chosen.sum(1)
    place = (_NEAR_QUANTILE * count).long()[:, None]
    return torch.where(count > 0, ordered.gather(1, place)[:, 0], 0.0)


def _colour(rgb: Tensor, which: Tensor, u: Tensor, v: Tensor) -> Tensor:
    """Bilinear colour (N, 3, CELLS, CELLS), the border replicated."""
    height, width = rgb.shape[1:3]
    u, v = u - 0.5, v - 0.5
    left, top = u.floor(), v.floor()
    du, dv = (u - left)[..., None], (v - top)[..., None]
    x0, x1 = (left + k for k in (0, 1))
    y0, y1 = (top + k for k in (0, 1))
    x0, x1 = (x.long().clamp(0, width - 1) for x in (x0, x1))
    y0, y1 = (y.long().clamp(0, height - 1) for y in (y0, y1))
    upper = rgb[which, y0, x0].float() * (1 - du) + rgb[which, y0, x1].float() * du
    lower = rgb[which, y1, x0].float() * (1 - du) + rgb[which, y1, x1].float() * du
    return (upper * (1 - dv) + lower * dv).permute(0, 3, 1, 2)


WEIGHTS_NAME = "refinement"
_CATEGORIES = len(Category)


@dataclass(frozen=True)
class RefinerConfig:
    """Architecture of the refiner; stored beside its weights.

    Attributes:
        widths: Channels at a square's resolution, and at a half, a quarter and an eighth of it.
    """

    widths: tuple[int, int, int, int] = (32, 64, 112, 144)

    def to_json(self) -> dict[str, Any]:
        """The fields as a JSON object."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> RefinerConfig:
        """Read the fields from a JSON object."""
        return cls(**{**data, "widths": tuple(data["widths"])})


class Refiner(nn.Module):
    """A U-Net (Ronneberger et al. 2015) over a square, with a head that predicts its mask's quality.

    Args:
        config: Architecture; None: the default.
    """

    def __init__(self, config: RefinerConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or RefinerConfig()
        w = config.widths
        self.first = nn.Sequential(*_conv(CHANNELS + _CATEGORIES, w[0]), *_conv(w[0], w[0]))
        self.descend = nn.ModuleList(
            nn.Sequential(*_conv(w[i], w[i + 1], 2), _Residual(w[i + 1])) for i in range(len(w) - 1)
        )
        self.ascend = nn.ModuleList(_Ascent(w[i + 1], w[i]) for i in range(len(w) - 1))
        self.output = nn.Conv2d(w[0], 1, 1)
        inputs = w[0] + w[-1] + 1 + _CATEGORIES
        hidden = nn.Linear(inputs, 128), nn.ReLU(), nn.Linear(128, 128), nn.ReLU()
        self.quality = nn.Sequential(*hidden, nn.Linear(128, 1))

    def forward(self, squares: Tensor, category: Tensor, score: Tensor) -> tuple[Tensor, Tensor]:
        """Predict masks.

        Args:
            squares: (N, CHANNELS, CELLS, CELLS), as `crops.sample_squares` makes them.
            category: Index of each category, (N,).
            score: The detector's scores in [0, 1], (N,).

        Returns:
            Logits (N, CELLS, CELLS) of the masks, and (N,) of their IoU with the truth, 0 where there is no such EE.
        """
        height, width = squares.shape[-2:]
        kind = F.one_hot(category, _CATEGORIES).to(squares.dtype)
        planes = kind[:, :, None, None].expand(-1, -1, height, width)
        x = self.first(torch.cat([(squares[:, :3] - 110.0) / 60.0, squares[:, 3:], planes], 1))
        levels = [x]
        for step in self.descend:
            levels.append(step(levels[-1]))
        x = levels[-1]
        whole = x.float().mean((2, 3))
        for i in range(len(self.ascend) - 1, -1, -1):
            x = self.ascend[i](x, levels[i])
        logits = self.output(x)[:, 0].float()
        inside = logits.detach().sigmoid()[:, None]
        within = (x.float() * inside).sum((2, 3)) / inside.sum((2, 3)).clamp(min=1.0)
        summary = torch.cat([within, whole, torch.logit(score, 1e-3)[:, None], kind], 1)
        return logits, self.quality(summary)[:, 0].float()

    def fuse(self) -> Refiner:
        """Fold batch normalisation into the convolutions, in place, for inference only."""
        self.eval()
        fold_normalisation(self)
        return self


class _Residual(nn.Module):
    """Residual block of two convolutions."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.body = nn.Sequential(*_conv(width, width), *_conv(width, width)[:-1])

    def forward(self, x: Tensor) -> Tensor:
        return F.relu(x + self.body(x))


class _Ascent(nn.Module):
    """Upsample a coarse level and join it with the next finer one."""

    def __init__(self, coarse: int, fine: int) -> None:
        super().__init__()
        self.narrow = nn.Conv2d(coarse, fine, 1)
        self.body = nn.Sequential(*_conv(2 * fine, fine), *_conv(fine, fine))

    def forward(self, coarse: Tensor, fine: Tensor) -> Tensor:
        above = F.interpolate(self.narrow(coarse), size=fine.shape[-2:], mode="bilinear", align_corners=False)
        out: Tensor = self.body(torch.cat([above, fine], 1))
        return out


def _conv(n_in: int, n_out: int, stride: int = 1) -> list[nn.Module]:
    conv = nn.Conv2d(n_in, n_out, 3, stride, 1, bias=False)
    nn.init.kaiming_normal_(conv.weight, mode="fan_out", nonlinearity="relu")
    return [conv, nn.BatchNorm2d(n_out), nn.ReLU()]


def load_refiner(refiner: Refiner, tensors: dict[str, Tensor]) -> None:
    """Load exported weights into a refiner.

    Args:
        refiner: The network, changed in place.
        tensors: The weights.

    Raises:
        AssetError: The weights do not fit.
    """
    load_into(refiner, tensors, "refiner")


class MaskRefinement:
    """A trained refiner, ready for inference. Thread-safe once loaded.

    Args:
        refiner: The trained network; its batch normalisation is fused in place.
        device: torch device that runs it.
        bfloat16: Whether a CPU computes in bfloat16.
    """

    def __init__(self, refiner: Refiner, device: torch.device, bfloat16: bool) -> None:
        self._device, self._bfloat16 = device, bfloat16
        self._refiner = refiner.fuse().to(device).to(memory_format=torch.channels_last)
        if bfloat16:
            in_bfloat16(self._refiner)

    @classmethod
    def load(cls, weights_dir: Path | None, device: torch.device, bfloat16: bool) -> MaskRefinement | None:
        """Load the refiner beside a detector's weights.

        Args:
            weights_dir: Folder of weights; None: the shipped ones.
            device: torch device that runs it.
            bfloat16: Whether a CPU computes in bfloat16.

        Returns:
            The refiner; None where the folder has none.

        Raises:
            AssetError: A file is unreadable or damaged; the message names it.
        """
        if not ((weights_dir or WEIGHTS_DIR) / f"{WEIGHTS_NAME}.json").is_file():
            return None
        tensors, description = load_weights(weights_dir, WEIGHTS_NAME)
        try:
            refiner = Refiner(RefinerConfig.from_json(description["model"]))
        except (KeyError, TypeError, ValueError) as error:
            raise AssetError(
                f"the refiner's description is damaged, fetch it again: {error!r}", code="asset.unreadable"
            ) from error
        load_refiner(refiner, tensors)
        return cls(refiner, device, bfloat16)

    @torch.inference_mode()
    def __call__(self, frame: RgbdFrame, instances: Sequence[Instance]) -> list[Instance]:
        """Refine the masks of end effectors.

        Args:
            frame: The frame.
            instances: The detector's instances in it.

        Returns:
            The instances, best score first, duplicates removed; EEs with new masks and with the geometric mean of the
            detector's score and the refiner's predicted IoU.
        """
        ees = [i for i in instances if i.label != TOOL]
        if not ees:
            return list(instances)
        d = self._device
        squares = Squares.about(torch.tensor([i.box for i in ees], dtype=torch.float32, device=d))
        logits, quality = self._outputs(
            frame,
            torch.from_numpy(np.stack([i.mask for i in ees])).to(d),
            squares,
            torch.tensor([i.label - 1 for i in ees], device=d),
            torch.tensor([i.score for i in ees], dtype=torch.float32, device=d),
        )
        probability, covered = logits.sigmoid().cpu().numpy(), squares.boxes().cpu().numpy().astype(np.float64)
        drawn = [paste_one(*each, *frame.depth.shape) for each in zip(probability, covered, strict=True)]
        better = iter(
            i._replace(mask=mask if mask.any() else i.mask, score=float(np.sqrt(i.score * good)))
            for i, mask, good in zip(ees, drawn, quality.sigmoid().tolist(), strict=True)
        )
        return without_duplicates([i if i.label == TOOL else next(better) for i in instances])

    def _outputs(
        self, frame: RgbdFrame, masks: torch.Tensor, squares: Squares, category: torch.Tensor, score: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Mask logits and quality logits: the means over each square and its mirror image."""
        d = self._device
        K = frame.intrinsics
        depth = np.nan_to_num(frame.depth, nan=0.0, posinf=0.0, neginf=0.0).astype(np.float32)
        images = Images(
            torch.from_numpy(np.ascontiguousarray(frame.rgb)).to(d)[None],
            torch.from_numpy(depth).to(d)[None],
            torch.tensor([float(np.sqrt(K.fx * K.fy))], dtype=torch.float32, device=d),
        )
        first = torch.zeros(len(masks), dtype=torch.long, device=d)
        which = torch.arange(len(masks), device=d)[:, None, None]
        both = [
            sample_squares(images, first, s, lambda u, v: masks[which, v, u])[0]
            for s in (squares, squares.mirrored_copy())
        ]
        seen = torch.cat(both).contiguous(memory_format=torch.channels_last)
        with torch.autocast(d.type, torch.bfloat16, enabled=self._bfloat16):
            logits, quality = self._refiner(seen, category.repeat(2), score.repeat(2))
        logits, again = logits.float().chunk(2)
        return (logits + again.flip(2)) / 2, quality.float().view(2, -1).mean(0)
