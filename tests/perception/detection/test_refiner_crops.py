"""Square crops around detections: positions of their cells in the image, colour and metric coordinates."""

from __future__ import annotations

import math

import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from toolee_robot.perception.detection.refiner import CELLS, CHANNELS, Images, MaskAt, Squares, sample_squares

HEIGHT, WIDTH = 60, 80
X, Y, Z, KNOWN, MASK = range(3, CHANNELS)
UNIT = 0.05
"""[m] Of the channels X, Y, Z, which end at 3."""


def images(count: int = 1, seed: int = 0) -> Images:
    """Noise of two scales in colour, and in depth, with holes."""
    generator = torch.Generator().manual_seed(seed)
    rgb = torch.randint(0, 256, (count, HEIGHT, WIDTH, 3), generator=generator, dtype=torch.uint8)
    coarse = torch.rand((count, HEIGHT // 4, WIDTH // 4), generator=generator)
    depth = 0.5 + 0.05 * coarse.repeat_interleave(4, 1).repeat_interleave(4, 2)
    depth = depth + 0.01 * torch.rand((count, HEIGHT, WIDTH), generator=generator)
    holes = torch.rand((count, HEIGHT, WIDTH), generator=generator) < 0.1
    return Images(rgb, torch.where(holes, 0.0, depth), 90.0 + 10.0 * torch.arange(count))


def plane(depth: Tensor, focal: float) -> Images:
    """Black, depth (H, W) [m]."""
    return Images(torch.zeros((1, *depth.shape, 3), dtype=torch.uint8), depth[None], torch.tensor([focal]))


def of_image(mask: Tensor) -> MaskAt:
    """Each square's mask is this one (H, W)."""
    return lambda column, row: mask[row, column]


def everywhere(column: Tensor, _row: Tensor) -> Tensor:
    return torch.ones_like(column, dtype=torch.bool)


def square(u: float, v: float, side: float, turn: float = 0.0, mirrored: float = 1.0) -> Squares:
    return Squares(torch.tensor([[u, v]]), *(torch.tensor([value]) for value in (side, turn, mirrored)))


FIRST = torch.zeros(1, dtype=torch.long)
"""Index of one square's image."""
MIDDLE = square(40.0, 30.0, 48.0)


@st.composite
def boxes(draw: st.DrawFn) -> tuple[float, float, float, float]:
    x, y = draw(st.floats(-50, 600)), draw(st.floats(-50, 600))
    return x, y, x + draw(st.floats(0.1, 400)), y + draw(st.floats(0.1, 400))


@given(st.lists(boxes(), min_size=1, max_size=4))
def test_the_cells_of_an_upright_square_fill_its_box_about_what_was_found(
    found: list[tuple[float, float, float, float]],
) -> None:
    about = Squares.about(torch.tensor(found))
    u, v = about.places()
    covered = about.boxes()
    side = covered[:, 2] - covered[:, 0]
    steps = (torch.arange(CELLS) + 0.5) / CELLS
    expected_u = covered[:, 0, None] + steps * side[:, None]
    expected_v = covered[:, 1, None] + steps * side[:, None]
    torch.testing.assert_close(u, expected_u[:, None, :].expand_as(u), atol=1e-3, rtol=0)
    torch.testing.assert_close(v, expected_v[:, :, None].expand_as(v), atol=1e-3, rtol=0)
    torch.testing.assert_close(covered[:, 3] - covered[:, 1], side, atol=1e-3, rtol=1e-5)
    for (x0, y0, x1, y1), within in zip(found, covered.tolist(), strict=True):
        room = 0.3 * max(x1 - x0, y1 - y0)
        assert within[0] <= x0 - room
        assert within[1] <= y0 - room
        assert within[2] >= x1 + room
        assert within[3] >= y1 + room
    assert (side > 23.9).all(), "the least thing still has surroundings"
    torch.testing.assert_close(about.mirrored_copy().boxes(), covered)


@given(
    st.floats(0.3, 1.2),
    st.floats(200.0, 900.0),
    st.floats(10.0, 70.0),
    st.floats(10.0, 50.0),
    st.floats(24.0, 50.0),
    st.floats(0.0, 2 * math.pi),
    st.sampled_from([-1.0, 1.0]),
)
def test_of_a_wall_the_places_are_metres_from_the_square_s_centre(
    z: float, focal: float, u: float, v: float, side: float, turn: float, mirrored: float
) -> None:
    """Along the square's own axes, however it lies, beyond the image as within."""
    scene = plane(torch.full((HEIGHT, WIDTH), z), focal)
    seen, _ = sample_squares(scene, FIRST, square(u, v, side, turn, mirrored), everywhere)
    metres = ((torch.arange(CELLS) + 0.5) / CELLS - 0.5) * side * z / focal
    expected = (metres / UNIT).clamp(-3, 3)
    torch.testing.assert_close(seen[0, X], expected[None, :].expand(CELLS, CELLS), atol=1e-3, rtol=1e-4)
    torch.testing.assert_close(seen[0, Y], expected[:, None].expand(CELLS, CELLS), atol=1e-3, rtol=1e-4)
    assert not seen[0, Z].any()


def test_depth_counts_from_what_the_mask_shows_though_it_leaks() -> None:
    """A thing 0.6 m away, a wall 4 cm behind it and one far behind; a third of the mask is of the far wall."""
    depth = torch.full((HEIGHT, WIDTH), 0.64)
    depth[:, 50:] = 1.2
    depth[:, 30:50] = 0.6
    mask = torch.zeros((HEIGHT, WIDTH), dtype=torch.bool)
    mask[:, 30:60] = True
    seen, pixels = sample_squares(plane(depth, 400.0), FIRST, MIDDLE, of_image(mask))
    column = pixels[0, 0]
    z = seen[0, Z]
    assert ((column >= 16) & (column < 64)).all()
    torch.testing.assert_close(z[(column >= 30) & (column < 50)].abs().max(), torch.tensor(0.0), atol=1e-4, rtol=0)
    behind = z[column < 30]
    torch.testing.assert_close(behind, torch.full_like(behind, 0.04 / UNIT), atol=1e-4, rtol=0)
    assert (z[column >= 50] == 3).all()
    assert (seen[0, MASK] > 0).equal((column >= 30) & (column < 60))
