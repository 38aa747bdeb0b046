"""The mask refiner: segments each detected end effector again in an enlarged crop, and scores the new mask.

The detector's mask head works on features of an image at one size, in which small things have few pixels. This network
sees only a square of the image around one detection, always at the same size, with the detector's mask as a hint (as
Tang et al., "Look Closer to Segment Better", CVPR 2021, refine outlines), and every pixel's metric position: an end
effector's mask ends where the tool leaves a sphere of some centimetres.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from toolee_robot.end_effectors import Category
from toolee_robot.perception.detection.refiner.crops import CHANNELS
from toolee_robot.perception.precision import fold_normalisation
from toolee_robot.perception.weight_files import load_into

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
