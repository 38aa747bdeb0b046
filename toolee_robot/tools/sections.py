"""Sections of solids: closed planar outlines, (M, 2), and the rings of a loft made of them, (N, M, 3)."""

from __future__ import annotations

from typing import Any

import numpy as np

from toolee_robot.frames import Array


def superellipse(exponent: float, points: int = 32) -> Array:
    """Unit superellipse |x|^n + |y|^n = 1.

    Args:
        exponent: The exponent n; 2 is a circle, 4 and above a rounded square.
        points: Number of points, M.

    Returns:
        The outline, counter-clockwise, (M, 2).
    """
    t = 2 * np.pi * np.arange(points) / points
    c, s = np.cos(t), np.sin(t)
    return np.column_stack([np.sign(c) * np.abs(c) ** (2 / exponent), np.sign(s) * np.abs(s) ** (2 / exponent)])


def regular_polygon(sides: int, points: int = 32, corner: float = 0.0) -> Array:
    """Regular polygon with inradius 1 and one side normal to x.

    Args:
        sides: Number of sides.
        points: Number of points, M.
        corner: Blend with the unit circle, in [0, 1): 0 keeps the corners sharp.

    Returns:
        The outline, counter-clockwise, (M, 2).
    """
    t = 2 * np.pi * np.arange(points) / points
    half = np.pi / sides
    r = 1.0 / np.cos((t + half) % (2 * half) - half)
    r = (1 - corner) * r + corner
    return r[:, None] * np.column_stack([np.cos(t), np.sin(t)])


def hexagon(flats: float) -> Array:
    """Corners (6, 2) of a hexagon `flats` across, two of its sides normal to y."""
    t = np.arange(6) * np.pi / 3
    return 0.5 * flats / np.cos(np.pi / 6) * np.column_stack([np.cos(t), np.sin(t)])


def lobes(count: int, depth: float, points: int = 48) -> Array:
    """Unit circle with flutes.

    Args:
        count: Number of flutes.
        depth: Depth of a flute as a share of the radius.
        points: Number of points, M.

    Returns:
        The outline, counter-clockwise, (M, 2).
    """
    t = 2 * np.pi * np.arange(points) / points
    r = 1.0 - depth * (0.5 - 0.5 * np.cos(count * t)) ** 2
    return r[:, None] * np.column_stack([np.cos(t), np.sin(t)])


def stack(z: Any, a: Any, b: Any = None, section: Array | None = None, x: Any = 0.0) -> Array:
    """Rings of a loft along z.

    Args:
        z: Heights of the rings (N,) [m].
        a: Half-widths along x, scalar or (N,) [m].
        b: Half-widths along y, scalar or (N,) [m]; `a` if None.
        section: Unit sections, (M, 2) or (N, M, 2); a circle if None.
        x: Centres of the rings along x, scalar or (N,) [m].

    Returns:
        Rings (N, M, 3) [m].
    """
    z = np.asarray(z, dtype=np.float64)
    a = np.broadcast_to(np.asarray(a, dtype=np.float64), z.shape)
    b = a if b is None else np.broadcast_to(np.asarray(b, dtype=np.float64), z.shape)
    x = np.broadcast_to(np.asarray(x, dtype=np.float64), z.shape)
    unit = superellipse(2.0) if section is None else section
    unit = np.broadcast_to(unit, (len(z), *unit.shape[-2:]))
    return np.stack(
        [x[:, None] + a[:, None] * unit[..., 0], b[:, None] * unit[..., 1], np.repeat(z[:, None], unit.shape[1], 1)],
        axis=-1,
    )
