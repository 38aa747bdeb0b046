"""The mask refiner: segments each detected end effector again in an enlarged crop, and scores the new mask.

The detector's mask head works on features of an image at one size, in which small things have few pixels. This network
sees only a square of the image around one detection, always at the same size, with the detector's mask as a hint (as
Tang et al., "Look Closer to Segment Better", CVPR 2021, refine outlines), and every pixel's metric position: an end
effector's mask ends where the tool leaves a sphere of some centimetres.
"""

from __future__ import annotations

from collections.abc import Sequence
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
from toolee_robot.perception.detection.refiner_crops import CHANNELS, Images, Squares, sample_squares
from toolee_robot.perception.precision import fold_normalisation, in_bfloat16
from toolee_robot.perception.weight_files import WEIGHTS_DIR, load_into, load_weights
from toolee_robot.types import RgbdFrame

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
