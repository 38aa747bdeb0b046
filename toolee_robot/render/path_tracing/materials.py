"""Mitsuba's materials for the surfaces of a scene: metals with measured optical constants, lacquer, wood, skin, rubber.

Of a `Material` only the kind of substance and the base colour are taken; its pattern and reflection are not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from toolee_robot.render.material import Material, Pattern
from toolee_robot.render.mesh import FloatArray
from toolee_robot.render.path_tracing.library import mitsuba
from toolee_robot.render.path_tracing.surroundings import Surroundings

Color = tuple[float, float, float]

_IRON = ((2.9114, 2.9497, 2.5845), (3.0893, 2.9318, 2.7670))
"""Refractive index and extinction coefficient of iron at the RGB wavelengths."""
_BRASS = ((0.444, 0.527, 1.094), (3.695, 2.765, 1.829))
"""The same of brass."""
_YELLOW = 1.5
"""Ratio of red to blue from which a metal is brass."""
_METAL, _SOFT = 0.5, 0.65
"""Metalness from which a surface is bare metal; roughness from which it is rubber, cloth or skin."""
_PATTERNED = {Pattern.CHECKER, Pattern.TILES, Pattern.STRIPES, Pattern.SPECKLE, Pattern.PLANKS}


@dataclass(frozen=True, eq=False)
class Finish:
    """A surface for Mitsuba.

    Attributes:
        bsdf: Its material, as Mitsuba's dictionary.
        texture_size: What a texture's side covers [m].
        shininess: Share of specular reflection in [0, 1], which the depth cameras' models ask for.
    """

    bsdf: dict[str, Any]
    texture_size: float
    shininess: float


def finish_of(material: Material, large: bool, surroundings: Surroundings, rng: np.random.Generator) -> Finish:
    """Draw a surface for a material.

    Args:
        material: The material.
        large: Whether it covers a floor, wall or ceiling.
        surroundings: Textures to choose from.
        rng: Random generator.

    Returns:
        The surface.
    """
    size = float(rng.uniform(0.6, 2.0) if large else rng.uniform(0.06, 0.3))
    roughness = float(np.clip(material.roughness + rng.normal(0.0, 0.1), 0.12, 1.0))
    if material.metallic > _METAL and not large:
        return Finish(_two_sided(_metal(material, roughness, rng)), size, 0.1 + 0.9 * (1.0 - roughness))
    color = _color(material, large, size, surroundings, rng)
    shininess = 0.1 * (1.0 - roughness)
    if material.metallic > 0.1:
        lacquer = {"clearcoat": float(rng.uniform(0.2, 1.0)), "clearcoat_gloss": float(rng.uniform(0.4, 0.95))}
        bsdf = _principled(color, roughness, metallic=material.metallic, **lacquer)
        shininess = (1.0 - roughness) * (0.1 + 0.9 * material.metallic)
    elif material.pattern is Pattern.WOOD:
        coated = rng.random() < 0.5
        bsdf = _principled(color, roughness, specular=0.4, clearcoat=float(coated) * float(rng.uniform(0.1, 0.6)))
    elif roughness > _SOFT or large:
        bsdf = _principled(color, roughness, specular=float(rng.uniform(0.1, 0.5)), sheen=float(rng.uniform(0.0, 0.5)))
    else:
        gloss = {"distribution": "ggx", "alpha": max(roughness**2, 0.03), "int_ior": float(rng.uniform(1.4, 1.6))}
        bsdf = {"type": "roughplastic", "diffuse_reflectance": color, "nonlinear": True, **gloss}
    return Finish(_two_sided(bsdf), size, shininess)


def _metal(material: Material, roughness: float, rng: np.random.Generator) -> dict[str, Any]:
    """Bare steel (iron or chromium, bright to blackened), or brass; a third of it brushed."""
    red, green, blue = material.color
    brightness = max((red + green + blue) / 3.0, 1e-3)
    alpha = max(roughness**2, 0.02)
    brushed = rng.random() < 0.35
    bsdf: dict[str, Any] = {
        "type": "roughconductor",
        "distribution": "ggx",
        "alpha_u": min(1.0, alpha * (3.0 if brushed else 1.0)),
        "alpha_v": alpha,
    }
    if red > _YELLOW * blue:
        constants: dict[str, Any] = {"eta": _rgb(_BRASS[0]), "k": _rgb(_BRASS[1])}
    elif rng.random() < 0.4:
        constants = {"material": "Cr"}
    else:
        constants = {"eta": _rgb(_IRON[0]), "k": _rgb(_IRON[1])}
    tint = np.clip(np.asarray(material.color) / brightness, 0.9, 1.1) * np.clip(1.8 * brightness, 0.2, 1.0)
    return {**bsdf, **constants, "specular_reflectance": _rgb(np.clip(tint, 0.0, 1.0))}


def _color(
    material: Material, large: bool, size: float, surroundings: Surroundings, rng: np.random.Generator
) -> dict[str, Any]:
    """Colour of a surface: plain, a photographed texture of about the colour, or squares."""
    base = np.asarray(material.color)
    textures, prints = surroundings.textures, surroundings.prints
    if material.pattern is Pattern.WOOD and surroundings.woods:
        return _picture(textures[int(rng.integers(surroundings.woods))], base, float(rng.uniform(0.4, 1.0)))
    patterned = material.pattern in _PATTERNED
    if textures and rng.random() < 0.25:
        return _picture(textures[int(rng.integers(len(textures)))], base, float(rng.uniform(0.0, 1.0)))
    if prints and patterned and rng.random() < 0.6:
        return _picture(prints[int(rng.integers(len(prints)))], base, float(rng.uniform(0.0, 0.5)))
    if patterned and rng.random() < 0.3:
        squares = mitsuba().ScalarTransform4f().scale(size / max(2.0 * material.scale, 1e-3))
        colors = {"color0": _rgb(material.color), "color1": _rgb(material.color2)}
        return {"type": "checkerboard", **colors, "to_uv": squares}
    if large:  # painted walls are pale
        base = 0.35 * base + 0.65 * float(rng.uniform(0.25, 0.75))
    return _rgb(np.clip(base, 0.02, 0.85))


def _picture(texture: FloatArray, base: Any, tinted: float) -> dict[str, Any]:
    """A texture, tinted towards a colour by a share."""
    mean = np.maximum(texture.mean(axis=(0, 1)), 0.02)
    gain = (1.0 - tinted) + tinted * np.clip(np.asarray(base), 0.02, 0.85) / mean
    image = np.clip(texture * gain.astype(np.float32), 0.0, 0.9).astype(np.float32)
    return {"type": "bitmap", "bitmap": mitsuba().Bitmap(image), "raw": True, "wrap_mode": "mirror"}


def _principled(color: dict[str, Any], roughness: float, **values: float) -> dict[str, Any]:
    return {"type": "principled", "base_color": color, "roughness": roughness, **values}


def _two_sided(bsdf: dict[str, Any]) -> dict[str, Any]:
    """Meshes of strangers may be wound badly or open: both sides reflect alike."""
    return {"type": "twosided", "bsdf": bsdf}


def _rgb(color: Any) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(c) for c in color]}
