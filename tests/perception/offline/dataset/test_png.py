"""The data set's PNG files against another program's reading of them."""

from __future__ import annotations

from io import BytesIO
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image

from tests.examples import examples
from toolee_robot.perception.offline.dataset.scenes import png_bytes


@st.composite
def images(draw: st.DrawFn) -> NDArray[Any]:
    """Noise or smooth, of each depth of bits, any width (the last byte of bits may be in part)."""
    shape = draw(st.integers(1, 9)), draw(st.integers(1, 40))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    kind = draw(st.sampled_from([np.uint16, np.uint8, np.bool_]))
    if kind is np.bool_:
        return rng.random(shape) < draw(st.sampled_from([0.0, 0.1, 0.5, 1.0]))
    high = np.iinfo(kind).max
    if draw(st.booleans()):
        return rng.integers(0, high, shape, dtype=kind, endpoint=True)
    return np.broadcast_to(np.linspace(0, high, shape[1]), shape).astype(kind)


@examples(60)
@given(images())
def test_another_program_reads_the_same_pixels(pixels: NDArray[Any]) -> None:
    read = np.asarray(Image.open(BytesIO(png_bytes(pixels))))
    assert read.dtype == pixels.dtype
    np.testing.assert_array_equal(read, pixels)


def test_other_pixels_are_refused() -> None:
    with pytest.raises(TypeError, match="float32"):
        png_bytes(np.zeros((2, 2), np.float32))
