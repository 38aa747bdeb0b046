"""Materials of tools: density for the mass, appearance for the renderer."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class Material:
    """A homogeneous material.

    Attributes:
        name: Identifier.
        density: Density [kg/m^3].
        color: Base colour, sRGB in [0, 1].
        roughness: Roughness of physically based shading, in [0, 1].
        metallic: Metalness of physically based shading, in [0, 1].
    """

    name: str
    density: float
    color: tuple[float, float, float]
    roughness: float
    metallic: float


STEEL_BRIGHT = Material("steel_bright", 7850.0, (0.72, 0.73, 0.75), 0.25, 1.0)
STEEL_DARK = Material("steel_dark", 7850.0, (0.22, 0.22, 0.24), 0.45, 0.9)
STEEL_PAINTED = Material("steel_painted", 7850.0, (0.60, 0.10, 0.10), 0.40, 0.0)
WOOD = Material("wood", 700.0, (0.74, 0.55, 0.34), 0.60, 0.0)
FIBERGLASS = Material("fiberglass", 1900.0, (0.90, 0.75, 0.10), 0.40, 0.0)
RUBBER = Material("rubber", 1200.0, (0.09, 0.09, 0.10), 0.85, 0.0)
RUBBER_COLORED = Material("rubber_colored", 1200.0, (0.70, 0.12, 0.10), 0.80, 0.0)
PLASTIC = Material("plastic", 1150.0, (0.85, 0.45, 0.08), 0.35, 0.0)
ALUMINIUM = Material("aluminium", 2700.0, (0.66, 0.67, 0.68), 0.40, 1.0)
BRASS = Material("brass", 8500.0, (0.78, 0.62, 0.30), 0.30, 1.0)

_PALETTE = np.array(
    [
        (0.80, 0.10, 0.10), (0.95, 0.50, 0.05), (0.95, 0.80, 0.10), (0.10, 0.45, 0.15), (0.10, 0.25, 0.65),
        (0.08, 0.08, 0.09), (0.35, 0.36, 0.38), (0.85, 0.85, 0.82), (0.10, 0.50, 0.60), (0.45, 0.15, 0.45),
    ]
)  # fmt: skip


def varied(material: Material, rng: np.random.Generator) -> Material:
    """A random variation of a material.

    Args:
        material: Nominal material. Painted steel, plastic, coloured rubber and fibreglass take any palette colour.
        rng: Random generator of the tool.

    Returns:
        The material with perturbed colour, roughness (x 0.7 to 1.3) and density (1 %, wood 12 %).
    """
    color = np.array(material.color)
    if material.name in ("steel_painted", "plastic", "rubber_colored", "fiberglass"):
        color = _PALETTE[rng.integers(len(_PALETTE))]
    color = np.clip(color * rng.uniform(0.85, 1.12) + rng.normal(0.0, 0.02, 3), 0.02, 0.98)
    spread = 0.12 if material.name == "wood" else 0.01
    return replace(
        material,
        color=(float(color[0]), float(color[1]), float(color[2])),
        roughness=float(np.clip(material.roughness * rng.uniform(0.7, 1.3), 0.05, 1.0)),
        density=material.density * float(rng.uniform(1 - spread, 1 + spread)),
    )


def steel(rng: np.random.Generator) -> Material:
    """A random variation of bright, dark or painted steel."""
    return varied((STEEL_BRIGHT, STEEL_DARK, STEEL_PAINTED)[rng.choice(3, p=[0.55, 0.3, 0.15])], rng)
