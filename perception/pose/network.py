"""The pose network: a patch transformer over the EE's cloud and the rest of the tool, a generative head and a
regression head.

Encoder: 64 patches of 32 points (marked where their depth is completed) within 12 mm of their centres, and 32 coarser
ones of the rest of the tool, a small PointNet each, then a transformer with tokens for the category and for the
direction to the rest of the tool, for when no more is known of that. Measured against PointNet++ at equal data it is
better and faster.
Generative head: what `NetworkConfig.process` asks for, conditioned by FiLM. About 5 M parameters, pure PyTorch.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from toolee_robot.end_effectors import CATEGORIES
from toolee_robot.perception.pose.canonical import PATCHES, REST_PATCHES, CanonicalCloud
from toolee_robot.perception.pose.processes.flow import Euler, Process
from toolee_robot.perception.pose.processes.registry import PROCESSES
from toolee_robot.perception.pose.representation import DIM
from toolee_robot.perception.precision import in_bfloat16

SAMPLER = Euler(3)
REGRESSED = ("mean", "log_sigma", "valid")
"""What `PoseNet.regress` gives."""
DIRECTION_DIM = 5
"""Direction (3), then flags: given at all; given as the direction to the hand, not to the tool's visible rest."""
CONTEXT_DIM = 2
"""log10 of the number of visible points - 2.5; distance of the cloud [m] - 0.7: what the noise depends on."""


@dataclass(frozen=True)
class NetworkConfig:
    """Sizes. ball: radius [m] of a patch of `neighbours` points; rest_ball, rest_neighbours: of the rest's.
    process: which of `PROCESSES` the generative head serves."""

    width: int = 256
    layers: int = 4
    heads: int = 8
    neighbours: int = 32
    ball: float = 0.012
    rest_neighbours: int = 16
    rest_ball: float = 0.03
    flow_width: int = 256
    flow_blocks: int = 3
    process: str = "edm"

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


class Seen(NamedTuple):
    """The network's input: a canonical cloud's points (B, 512, 3) [m] with completed (B, 512), and rest (B, 256, 3) [m]
    with rest_known (B,); the category (B,); the tokens direction (B, 5) and context (B, 2)."""

    points: Tensor
    completed: Tensor
    rest: Tensor
    rest_known: Tensor
    category: Tensor
    direction: Tensor
    context: Tensor

    @staticmethod
    def of(cloud: CanonicalCloud, category: Tensor, direction: Tensor, context: Tensor) -> Seen:
        """On the category's device."""
        to = category.device
        points, completed, tokens = cloud.points.to(to), cloud.completed.to(to), (direction.to(to), context.to(to))
        return Seen(points, completed, cloud.rest.to(to), cloud.rest_known.to(to), category, *tokens)

    def with_mirror(self) -> Seen:
        """Twice as many: as they are, then their mirror images in x."""
        other = self._replace(points=_in_x(self.points), rest=_in_x(self.rest), direction=_in_x(self.direction))
        return Seen(*(torch.cat(pair) for pair in zip(self, other, strict=True)))


def _in_x(x: Tensor) -> Tensor:
    return torch.cat([-x[..., :1], x[..., 1:]], -1)


class PoseNet(nn.Module):
    """Heads on one shared encoding; see `encode`, `flow` and `regress`."""

    def __init__(self, config: NetworkConfig | None = None) -> None:
        super().__init__()
        c = self.config = config or NetworkConfig()
        d = c.width
        self.ee = Patches(d, PATCHES, c.neighbours, c.ball, 0.02, marked=True)
        self.rest = Patches(d, REST_PATCHES, c.rest_neighbours, c.rest_ball, 0.1)
        self.no_rest = nn.Parameter(torch.zeros(d))
        self.category = nn.Embedding(len(CATEGORIES), d)
        self.direction = nn.Sequential(nn.Linear(DIRECTION_DIM, d), nn.SiLU(), nn.Linear(d, d))
        self.context = nn.Sequential(nn.Linear(CONTEXT_DIM, d // 2), nn.SiLU(), nn.Linear(d // 2, d))
        self.blocks = nn.ModuleList([Block(d, c.heads) for _ in range(c.layers)])
        self.norm = nn.LayerNorm(d)
        f = 2 * d
        self.flow = FlowHead(f, c.flow_width, c.flow_blocks)
        # mean of u (12; the S part as logits), log sigma of position, axis, spin; logit that this is an EE at all.
        self.regression = nn.Sequential(nn.Linear(f, d), nn.SiLU(), nn.Linear(d, d), nn.SiLU(), nn.Linear(d, DIM + 4))

    @property
    def process(self) -> Process:
        """How its poses become noise, and the way back."""
        return PROCESSES[self.config.process]

    def encode(self, seen: Seen, mirror: bool = False) -> Tensor:
        """Feature (B, 2 width) of what is seen; with `mirror` (2 B, 2 width): then of its mirror image in x."""
        both = seen.with_mirror() if mirror else seen
        tokens = torch.cat(
            [
                self.category(both.category)[:, None],
                self.direction(both.direction)[:, None],
                self.context(both.context)[:, None],
                self.ee(seen.points, seen.completed, mirror),
                self.rest_tokens(seen, mirror),
            ],
            dim=1,
        )
        for block in self.blocks[:-1]:
            tokens = block(tokens)
        tokens = self.norm(self.blocks[-1](tokens, 3 + PATCHES))
        return torch.cat([tokens[:, 0], tokens[:, 3:].mean(1)], dim=-1)

    def encoder_in_bfloat16(self) -> None:
        """See `in_bfloat16`. The heads, small as they are, stay as they are, and so do normalisations and sums of
        tokens."""
        for part in (self.ee, self.rest, self.direction, self.context, self.blocks):
            in_bfloat16(part)

    def rest_tokens(self, seen: Seen, mirror: bool = False) -> Tensor:
        """(B, 32, width) of the rest of the tool; with `mirror` (2 B, 32, width) as in `encode`."""
        known = seen.rest_known.repeat(2) if mirror else seen.rest_known
        return torch.where(known[:, None, None], self.rest(seen.rest, mirror=mirror), self.no_rest)

    def regress(self, feature: Tensor) -> dict[str, Tensor]:
        """mean (B, 12), log_sigma (B, 3) of position [units of T], axis [rad], spin [rad], validity logit (B,)."""
        out = self.regression(feature).float()
        return {"mean": out[:, :DIM], "log_sigma": out[:, DIM : DIM + 3].clamp(-6, 2), "valid": out[:, DIM + 3]}

    def forward(self, seen: Seen, u: Tensor, t: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        """What training needs in one call: velocities (B, K, 12) at u (B, K, 12), t (B, K), and the regression."""
        feature = self.encode(seen)
        return self.flow(u, t, self.flow.condition(feature)), self.regress(feature)


class Patches(nn.Module):
    """A small PointNet on the neighbourhood of each of a cloud's first points: tokens (B, count, width)."""

    def __init__(
        self, width: int, count: int, neighbours: int, ball: float, scale: float, marked: bool = False
    ) -> None:
        """ball [m]: of a patch; scale [m]: of the places. marked: the points come with a mark each."""
        super().__init__()
        self._count, self._neighbours, self._ball, self._scale = count, neighbours, ball, scale
        self.inner = nn.Sequential(nn.Linear(3 + marked, width // 4), nn.SiLU(), nn.Linear(width // 4, width // 2))
        self.outer = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
        self.place = nn.Sequential(nn.Linear(3, width // 2), nn.SiLU(), nn.Linear(width // 2, width))

    def forward(self, points: Tensor, marks: Tensor | None = None, mirror: bool = False) -> Tensor:
        """points (B, N, 3) [m], marks (B, N) -> tokens (B, count, width); with `mirror` (2 B, count, width): then those
        of the points' mirror image in x, whose neighbours are the same."""
        centres = points[:, : self._count]
        patches = self._patches(centres, points, marks)
        if mirror:
            centres, patches = (torch.cat([x, _in_x(x)]) for x in (centres, patches))
        h = self.inner(patches)
        # In training max(dim): under torch.compile in bfloat16 the gradient of amax, which is faster, was not finite.
        pooled = h.max(2)[0] if self.training else h.amax(2)
        tokens: Tensor = self.outer(torch.cat([pooled, _mean(h)], dim=-1)) + self.place(centres / self._scale)
        return tokens

    @torch.no_grad()
    def _patches(self, centres: Tensor, points: Tensor, marks: Tensor | None) -> Tensor:
        """(B, count, neighbours, 3 or 4): about their centres, in radii of the ball; the mark last."""
        # By coordinate: a sum over an axis of three takes 2.5 times as long.
        x, y, z = ((centres[:, :, None, k] - points[:, None, :, k]).square() for k in range(3))
        squared = x + y + z
        near, index = squared.topk(self._neighbours, dim=-1, largest=False, sorted=False)
        rows = index.flatten(1)[..., None].expand(-1, -1, 3)
        patches = points.gather(1, rows).view(*index.shape, 3) - centres[:, :, None]
        # A neighbour outside of the ball is replaced by the centre itself.
        inside = near < self._ball**2
        patches = torch.where(inside[..., None], patches, 0.0) / self._ball
        if marks is None:
            return patches
        own = marks[:, : self._count, None]
        mark = torch.where(inside, marks.gather(1, index.flatten(1)).view(index.shape), own)
        return torch.cat([patches, mark[..., None]], -1)


def _mean(h: Tensor) -> Tensor:
    """Of h (B, count, neighbours, width) over the neighbours. In bfloat16 a processor takes 2.5 times as long for a sum
    as for a product."""
    if h.device.type != "cpu" or h.dtype is not torch.bfloat16:
        return h.mean(2)
    share = h.new_full((1, h.shape[2]), 1.0 / h.shape[2])
    return (share @ h)[:, :, 0]


class Block(nn.Module):
    """Pre-norm transformer block."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.norm_1, self.norm_2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.qkv, self.out = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.mlp = nn.Sequential(nn.Linear(width, 4 * width), nn.GELU(), nn.Linear(4 * width, width))

    def forward(self, x: Tensor, count: int | None = None) -> Tensor:
        """The first `count` of the tokens x (B, N, width), all if None."""
        B, N, d = x.shape
        q, k, v = self.qkv(self.norm_1(x)).view(B, N, 3, self.heads, d // self.heads).permute(2, 0, 3, 1, 4)
        attended = nn.functional.scaled_dot_product_attention(q[:, :, :count], k, v)
        x = x[:, :count] + self.out(attended.transpose(1, 2).flatten(2))
        return x + self.mlp(self.norm_2(x))


class FlowHead(nn.Module):
    """Velocity of u at time t, given the cloud's feature: residual MLP with FiLM from the feature (once a cloud)."""

    frequencies: Tensor

    def __init__(self, feature: int, width: int, blocks: int, frequencies: int = 16) -> None:
        super().__init__()
        self.width = width
        self.register_buffer("frequencies", torch.pi * torch.arange(1, frequencies + 1), persistent=False)
        self.film = nn.Linear(feature, blocks * 2 * width)
        self.into = nn.Linear(DIM + 2 * frequencies, width)
        self.norm = nn.LayerNorm(width, elementwise_affine=False)
        self.layers = nn.ModuleList(
            [nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width)) for _ in range(blocks)]
        )
        self.out = nn.Linear(width, DIM)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def condition(self, feature: Tensor) -> Tensor:
        """(B, blocks, 2, width): scale and shift of every block."""
        return self.film(nn.functional.silu(feature)).unflatten(-1, (len(self.layers), 2, self.width))

    def forward(self, u: Tensor, t: Tensor, condition: Tensor) -> Tensor:
        """u (B, K, 12), t (B, K) in [0, 1] -> (B, K, 12)."""
        phase = t[..., None] * self.frequencies.to(t.dtype)
        h = self.into(torch.cat([u, phase.sin(), phase.cos()], dim=-1))
        for i, layer in enumerate(self.layers):
            scale, shift = condition[:, i, 0, None], condition[:, i, 1, None]
            h = h + layer(self.norm(h) * (1 + scale) + shift)
        return self.out(h)
