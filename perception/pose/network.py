"""The pose network: a patch transformer over the EE's cloud, a flow-matching head and a regression head.

Encoder: 64 patches of 32 points within 12 mm of their centres, a small PointNet each, then a transformer with tokens
for the category and for the direction to the rest of the tool. Measured against PointNet++ at equal data it is better
and faster. Flow head: the velocity of `flow.RectifiedFlow`, conditioned by FiLM. About 4.8 M parameters, pure PyTorch.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import torch
from torch import Tensor, nn

from toolee_robot.perception.pose.canonical import PATCHES
from toolee_robot.perception.pose.flow import Euler, Process, RectifiedFlow, Sampler
from toolee_robot.perception.pose.representation import DIM
from toolee_robot.types import Category

CATEGORIES = tuple(Category)
FLOW = RectifiedFlow()
SAMPLER = Euler(5)
DIRECTION_DIM = 5
"""Direction (3), then flags: given at all; given as the direction to the hand, not to the tool's visible rest."""
CONTEXT_DIM = 2
"""log10 of the number of visible points - 2.5; distance of the cloud [m] - 0.7: what the noise depends on."""


@dataclass(frozen=True)
class NetworkConfig:
    """Sizes. ball: radius [m] of a patch of `neighbours` points."""

    width: int = 256
    layers: int = 4
    heads: int = 8
    neighbours: int = 32
    ball: float = 0.012
    flow_width: int = 256
    flow_blocks: int = 3

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


class PoseNet(nn.Module):
    """Heads on one shared encoding; see `encode`, `velocity` and `regress`."""

    def __init__(self, config: NetworkConfig | None = None) -> None:
        super().__init__()
        c = self.config = config or NetworkConfig()
        d = c.width
        self.patch_in = nn.Sequential(nn.Linear(3, d // 4), nn.SiLU(), nn.Linear(d // 4, d // 2))
        self.patch_out = nn.Sequential(nn.Linear(d, d), nn.SiLU(), nn.Linear(d, d))
        self.centre = nn.Sequential(nn.Linear(3, d // 2), nn.SiLU(), nn.Linear(d // 2, d))
        self.category = nn.Embedding(len(CATEGORIES), d)
        self.direction = nn.Sequential(nn.Linear(DIRECTION_DIM, d), nn.SiLU(), nn.Linear(d, d))
        self.context = nn.Sequential(nn.Linear(CONTEXT_DIM, d // 2), nn.SiLU(), nn.Linear(d // 2, d))
        self.blocks = nn.ModuleList([Block(d, c.heads) for _ in range(c.layers)])
        self.norm = nn.LayerNorm(d)
        f = 2 * d
        self.flow = FlowHead(f, c.flow_width, c.flow_blocks)
        # mean of u (12; the S part as logits), log sigma of position, axis, spin; logit that this is an EE at all.
        self.regression = nn.Sequential(nn.Linear(f, d), nn.SiLU(), nn.Linear(d, d), nn.SiLU(), nn.Linear(d, DIM + 4))

    def encode(self, points: Tensor, category: Tensor, direction: Tensor, context: Tensor) -> Tensor:
        """Feature (B, 2 width) of clouds (B, 512, 3) [m, canonical frame], category (B,) and tokens (B, 5), (B, 2)."""
        c = self.config
        centres = points[:, :PATCHES]
        with torch.no_grad():
            squared = (centres[:, :, None] - points[:, None]).square().sum(-1)
            near, index = squared.topk(c.neighbours, dim=-1, largest=False, sorted=False)
            rows = index.flatten(1)[..., None].expand(-1, -1, 3)
            patches = points.gather(1, rows).view(*index.shape, 3) - centres[:, :, None]
            # A neighbour outside of the ball is replaced by the centre itself.
            patches = torch.where((near < c.ball**2)[..., None], patches, 0.0) / c.ball
        h = self.patch_in(patches)
        # max(dim), not amax: under torch.compile in bfloat16 the gradient of amax was not finite.
        pooled = h.max(2)[0]
        h = self.patch_out(torch.cat([pooled, h.mean(2)], dim=-1))
        tokens = torch.cat(
            [
                self.category(category)[:, None],
                self.direction(direction)[:, None],
                self.context(context)[:, None],
                h + self.centre(centres / 0.02),
            ],
            dim=1,
        )
        for block in self.blocks:
            tokens = block(tokens)
        tokens = self.norm(tokens)
        return torch.cat([tokens[:, 0], tokens[:, 3:].mean(1)], dim=-1)

    def regress(self, feature: Tensor) -> dict[str, Tensor]:
        """mean (B, 12), log_sigma (B, 3) of position [units of T], axis [rad], spin [rad], validity logit (B,)."""
        out = self.regression(feature).float()
        return {"mean": out[:, :DIM], "log_sigma": out[:, DIM : DIM + 3].clamp(-6, 2), "valid": out[:, DIM + 3]}

    def forward(
        self, points: Tensor, category: Tensor, direction: Tensor, context: Tensor, u: Tensor, t: Tensor
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """What training needs in one call: velocities (B, K, 12) at u (B, K, 12), t (B, K), and the regression."""
        feature = self.encode(points, category, direction, context)
        return self.flow(u, t, self.flow.condition(feature)), self.regress(feature)


class Block(nn.Module):
    """Pre-norm transformer block."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.norm_1, self.norm_2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.qkv, self.out = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.mlp = nn.Sequential(nn.Linear(width, 4 * width), nn.GELU(), nn.Linear(4 * width, width))

    def forward(self, x: Tensor) -> Tensor:
        B, N, d = x.shape
        q, k, v = self.qkv(self.norm_1(x)).view(B, N, 3, self.heads, d // self.heads).permute(2, 0, 3, 1, 4)
        attended = nn.functional.scaled_dot_product_attention(q, k, v)
        x = x + self.out(attended.transpose(1, 2).reshape(B, N, d))
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


@torch.no_grad()
def sample(
    net: PoseNet,
    feature: Tensor,
    K: int,
    generator: torch.Generator,
    sampler: Sampler = SAMPLER,
    process: Process = FLOW,
) -> Tensor:
    """K draws of u (B, K, 12).

    The noise comes from `generator`, which must live on the CPU: the same seed gives the same draws on any device.
    """
    noise = torch.randn(feature.shape[0], K, DIM, generator=generator).to(feature)
    condition = net.flow.condition(feature)
    return sampler(process, lambda u, t: net.flow(u, t, condition), noise)
