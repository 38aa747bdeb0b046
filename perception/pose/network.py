"""The pose network: a patch transformer over the EE's cloud and the rest of the tool, with two heads.

Encoder: 64 patches of 32 points (marked where their depth is completed) within 12 mm of their centres, and 32 coarser
patches of the rest of the tool, each through a small PointNet (Qi et al., CVPR 2017); then a transformer with tokens
for the category, for the direction to the rest of the tool (in case its points are not seen) and for the context.
Better and faster than PointNet++ at equal training data.
Generative head: the field of the process, EDM's, conditioned by FiLM. Regression head: the mean pose, its sigmas and
the validity. About 5 M parameters, pure PyTorch.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from toolee_robot.end_effectors import CATEGORIES
from toolee_robot.perception.pose.canonical import PATCHES, REST_PATCHES, CanonicalCloud
from toolee_robot.perception.pose.processes import Edm, Euler
from toolee_robot.perception.pose.representation import DIM
from toolee_robot.perception.precision import in_bfloat16


class Patches(nn.Module):
    """A small PointNet on the neighbourhood of each of a cloud's first points.

    Args:
        width: Width of the tokens.
        count: Number of patches: the first so many points are their centres.
        neighbours: Points per patch.
        ball: Radius of a patch [m]; farther neighbours are replaced by the centre.
        scale: Scale [m] of the centres' coordinates.
        marked: Whether each point comes with a mark (1 channel).
    """

    def __init__(
        self, width: int, count: int, neighbours: int, ball: float, scale: float, marked: bool = False
    ) -> None:
        super().__init__()
        self._count, self._neighbours, self._ball, self._scale = count, neighbours, ball, scale
        self.inner = nn.Sequential(nn.Linear(3 + marked, width // 4), nn.SiLU(), nn.Linear(width // 4, width // 2))
        self.outer = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
        self.place = nn.Sequential(nn.Linear(3, width // 2), nn.SiLU(), nn.Linear(width // 2, width))

    def forward(self, points: Tensor, marks: Tensor | None = None, mirror: bool = False) -> Tensor:
        """Tokens of a cloud's patches.

        Args:
            points: (B, N, 3) [m], the patches' centres first.
            marks: (B, N), where the points are marked.
            mirror: Whether to add the mirror image in x; its neighbourhoods are the same.

        Returns:
            (B, count, width); with `mirror` (2 B, count, width).
        """
        centres = points[:, : self._count]
        patches = self._patches(centres, points, marks)
        if mirror:
            centres, patches = (torch.cat([x, mirror_x(x)]) for x in (centres, patches))
        h = self.inner(patches)
        # In training max(dim): under torch.compile in bfloat16 the gradient of amax, which is faster, was not finite.
        pooled = h.max(2)[0] if self.training else h.amax(2)
        tokens: Tensor = self.outer(torch.cat([pooled, _mean(h)], dim=-1)) + self.place(centres / self._scale)
        return tokens

    @torch.no_grad()
    def _patches(self, centres: Tensor, points: Tensor, marks: Tensor | None) -> Tensor:
        """Patches (B, count, neighbours, 3 or 4) relative to their centres, in radii of the ball; the mark last."""
        # Summed per coordinate: a reduction over an axis of three takes 2.5 times as long.
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
    """Mean of h (B, count, neighbours, width) over the neighbours; in bfloat16 on a CPU as a product (faster)."""
    if h.device.type != "cpu" or h.dtype is not torch.bfloat16:
        return h.mean(2)
    share = h.new_full((1, h.shape[2]), 1.0 / h.shape[2])
    return (share @ h)[:, :, 0]


def mirror_x(x: Tensor) -> Tensor:
    """Mirror vectors (..., 3 or more) in x."""
    return torch.cat([-x[..., :1], x[..., 1:]], -1)


SAMPLER = Euler(3)
"""Default solver of the generative process."""
REGRESSED = ("mean", "log_sigma", "valid")
"""Names of the outputs of `PoseNet.regress`."""
DIRECTION_DIM = 5
"""Unit direction (3), then two flags: direction given; given toward the hand instead of the visible
rest of the tool."""
CONTEXT_DIM = 2
"""log10 of the number of visible points - 2.5; distance of the cloud [m] - 0.7: the sensor's noise depends on both."""


@dataclass(frozen=True)
class NetworkConfig:
    """Architecture of the pose network; stored beside its weights.

    Attributes:
        width: Width of the tokens.
        layers: Transformer blocks.
        heads: Attention heads per block.
        neighbours: Points per patch of the EE's cloud.
        ball: Radius [m] of such a patch.
        rest_neighbours: Points per patch of the rest of the tool.
        rest_ball: Radius [m] of such a patch.
        flow_width: Width of the generative head.
        flow_blocks: Residual blocks of the generative head.
        process: Name of the generative process, "edm".
    """

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

    def __post_init__(self) -> None:
        if self.process != "edm":
            raise ValueError(f"process {self.process}: only edm is sampled, train it again")

    def to_dict(self) -> dict[str, Any]:
        """The fields as a JSON object."""
        return asdict(self)


class Seen(NamedTuple):
    """Input of the network, a batch of B.

    Attributes:
        points: Points of the canonical cloud, (B, 512, 3) [m].
        completed: (B, 512), 1 where a point's depth is completed.
        rest: Points of the rest of the tool, (B, 256, 3) [m], canonical frame.
        rest_known: Whether the rest is known, (B,) bool.
        category: Index of the category, (B,).
        direction: Direction token, (B, 5); see `DIRECTION_DIM`.
        context: Context token, (B, 2); see `CONTEXT_DIM`.
    """

    points: Tensor
    completed: Tensor
    rest: Tensor
    rest_known: Tensor
    category: Tensor
    direction: Tensor
    context: Tensor

    @staticmethod
    def of(cloud: CanonicalCloud, category: Tensor, direction: Tensor, context: Tensor) -> Seen:
        """The input of a batch.

        Args:
            cloud: The canonical clouds.
            category: Index of each category, (B,); the input is on its device.
            direction: Direction tokens, (B, 5).
            context: Context tokens, (B, 2).

        Returns:
            The input.
        """
        to = category.device
        points, completed, tokens = cloud.points.to(to), cloud.completed.to(to), (direction.to(to), context.to(to))
        return Seen(points, completed, cloud.rest.to(to), cloud.rest_known.to(to), category, *tokens)

    def with_mirror(self) -> Seen:
        """A batch of 2 B: the input, then its mirror image in x."""
        other = self._replace(
            points=mirror_x(self.points), rest=mirror_x(self.rest), direction=mirror_x(self.direction)
        )
        return Seen(*(torch.cat(pair) for pair in zip(self, other, strict=True)))


class PoseNet(nn.Module):
    """Pose network: one encoder with a generative and a regression head; see `encode`, `flow` and `regress`.

    Args:
        config: Architecture; None: the default.
    """

    process = Edm()

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

    def encode(self, seen: Seen, mirror: bool = False) -> Tensor:
        """Encode clouds.

        Args:
            seen: The input, a batch of B.
            mirror: Whether to encode the mirror image in x, too.

        Returns:
            Feature (B, 2 width); with `mirror` (2 B, 2 width), the mirror images last.
        """
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
        """Compute the encoder's products in bfloat16 (`in_bfloat16`); heads, norms and sums stay in float32."""
        for part in (self.ee, self.rest, self.direction, self.context, self.blocks):
            in_bfloat16(part)

    def rest_tokens(self, seen: Seen, mirror: bool = False) -> Tensor:
        """Encode the rest of the tool.

        Args:
            seen: The network's input.
            mirror: Whether to append the tokens of the mirror images, as in `encode`.

        Returns:
            Tokens, (B, 32, width), with `mirror` (2 B, 32, width); a learnt constant where the rest is not known.
        """
        known = seen.rest_known.repeat(2) if mirror else seen.rest_known
        return torch.where(known[:, None, None], self.rest(seen.rest, mirror=mirror), self.no_rest)

    def regress(self, feature: Tensor) -> dict[str, Tensor]:
        """Regress the pose and its uncertainty.

        Args:
            feature: Encoded clouds, (B, 2 width).

        Returns:
            "mean": pose u (B, 12); "log_sigma": (B, 3) of position [units of T], axis [rad] and spin [rad]; "valid":
            logit (B,) that the cloud shows an EE of the category.
        """
        out = self.regression(feature).float()
        return {"mean": out[:, :DIM], "log_sigma": out[:, DIM : DIM + 3].clamp(-6, 2), "valid": out[:, DIM + 3]}

    def forward(self, seen: Seen, u: Tensor, t: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        """Both heads in one call, for training.

        Args:
            seen: The input, a batch of B.
            u: Noised poses, (B, K, 12).
            t: Their times, (B, K).

        Returns:
            The generative head's output (B, K, 12), and the regression; see `regress`.
        """
        feature = self.encode(seen)
        return self.flow(u, t, self.flow.condition(feature)), self.regress(feature)


class Block(nn.Module):
    """Pre-norm transformer block.

    Args:
        width: Width of the tokens.
        heads: Attention heads.
    """

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.norm_1, self.norm_2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.qkv, self.out = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.mlp = nn.Sequential(nn.Linear(width, 4 * width), nn.GELU(), nn.Linear(4 * width, width))

    def forward(self, x: Tensor, count: int | None = None) -> Tensor:
        """Attend and transform.

        Args:
            x: Tokens (B, N, width).
            count: Number of first tokens to compute; None: all.

        Returns:
            The first `count` tokens, (B, count, width).
        """
        B, N, d = x.shape
        q, k, v = self.qkv(self.norm_1(x)).view(B, N, 3, self.heads, d // self.heads).permute(2, 0, 3, 1, 4)
        attended = nn.functional.scaled_dot_product_attention(q[:, :, :count], k, v)
        x = x[:, :count] + self.out(attended.transpose(1, 2).flatten(2))
        return x + self.mlp(self.norm_2(x))


class FlowHead(nn.Module):
    """Generative head: a residual MLP on u and t, with FiLM conditioning (Perez et al. 2018) from the cloud's feature.

    Args:
        feature: Width of the feature.
        width: Width of the MLP.
        blocks: Residual blocks.
        frequencies: Fourier features of t.
    """

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
        """Scale and shift of every block, (B, blocks, 2, width), from the feature (B, feature); once per cloud."""
        return self.film(nn.functional.silu(feature)).unflatten(-1, (len(self.layers), 2, self.width))

    def forward(self, u: Tensor, t: Tensor, condition: Tensor) -> Tensor:
        """Evaluate the field.

        Args:
            u: States, (B, K, 12).
            t: Times in [0, 1], (B, K).
            condition: The head's conditioning on the cloud, (B, blocks, 2, width): scales and shifts.

        Returns:
            The field at u and t, (B, K, 12).
        """
        phase = t[..., None] * self.frequencies.to(t.dtype)
        h = self.into(torch.cat([u, phase.sin(), phase.cos()], dim=-1))
        for i, layer in enumerate(self.layers):
            scale, shift = condition[:, i, 0, None], condition[:, i, 1, None]
            h = h + layer(self.norm(h) * (1 + scale) + shift)
        return self.out(h)
