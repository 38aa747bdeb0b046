"""Materials by name and sRGB colour, and random colours."""

from __future__ import annotations

import numpy as np

from toolee_robot.render.material import Material, Pattern

Color = tuple[float, float, float]

_MONK = (0xF6EDE4, 0xF3E7DB, 0xF7EAD0, 0xEADABA, 0xD7BD96, 0xA07E56, 0x825C43, 0x604134, 0x3A312A, 0x292420)
"""The ten tones of the Monk Skin Tone Scale (E. Monk, 2019), sRGB."""
_GLOVES = ((0.15, 0.35, 0.75), (0.08, 0.08, 0.09), (0.92, 0.92, 0.90), (0.95, 0.45, 0.10), (0.20, 0.60, 0.35))
"""Usual colours of working gloves: blue, black, white, orange and green."""


def linear(srgb: Color) -> Color:
    """Linear RGB of an sRGB colour in [0, 1]."""
    r, g, b = srgb
    return _linear(r), _linear(g), _linear(b)


def _linear(value: float) -> float:
    c = min(max(float(value), 0.0), 1.0)
    return c / 12.92 if c <= 0.04045 else float(((c + 0.055) / 1.055) ** 2.4)


def finish(
    name: str, srgb: Color, roughness: float, metallic: float, rng: np.random.Generator, axis: int = 2
) -> Material:
    """A material with the texture of a named substance: grain on wood, scratches on metal, mottling on rubber and skin.

    Args:
        name: Name as in `toolee_robot.tools.materials`, or another one such as "wood_block", "skin" or "concrete".
        srgb: Base colour, sRGB in [0, 1].
        roughness: Roughness in [0, 1] before ageing.
        metallic: Metalness in [0, 1].
        rng: Random generator of the pattern offset and the age of the surface.
        axis: Body axis (0, 1, 2) of grain and scratches.

    Returns:
        The material, linear RGB.
    """
    r, g, b = linear(srgb)
    x, y, z = rng.uniform(-1.0, 1.0, 3).tolist()
    age = float(rng.uniform(0.0, 0.5))
    factor, pattern, scale, wear = 1.0, Pattern.SOLID, 0.02, 0.3 * age
    if name.startswith("wood"):
        factor, pattern, scale = float(rng.uniform(0.5, 0.75)), Pattern.WOOD, float(rng.uniform(0.006, 0.014))
    elif name.startswith("steel") or name in ("brass", "aluminium"):
        factor, pattern, scale = 1.0 - 0.7 * age, Pattern.SCRATCHES, float(rng.uniform(0.002, 0.006))
        wear = age
    elif name.startswith("rubber") or name == "skin":
        factor, pattern, scale = float(rng.uniform(0.75, 0.95)), Pattern.CLOUD, float(rng.uniform(0.004, 0.02))
    elif name == "concrete":
        factor, pattern, scale = 0.75, Pattern.CLOUD, 0.05
    return Material(
        color=(r, g, b),
        color2=(r * factor, g * factor, b * factor),
        pattern=pattern,
        scale=scale,
        axis=axis,
        roughness=min(max(roughness + 0.25 * age * metallic, 0.05), 1.0),
        metallic=metallic,
        wear=wear,
        offset=(x, y, z),
    )


def skin_tone(rng: np.random.Generator) -> Color:
    """A random skin colour, sRGB in [0, 1]."""
    light, dark = np.array([0.92, 0.74, 0.64]), np.array([0.28, 0.17, 0.12])
    c = np.clip(dark + rng.uniform() * (light - dark) + rng.normal(0.0, 0.02, 3), 0.0, 1.0)
    return float(c[0]), float(c[1]), float(c[2])


def any_skin_tone(rng: np.random.Generator) -> Color:
    """A random skin colour, sRGB in [0, 1]: between neighbours of the Monk scale, more or less reddened."""
    scale = np.array([[tone >> 16, tone >> 8 & 255, tone & 255] for tone in _MONK]) / 255.0
    k = rng.uniform(0.0, len(_MONK) - 1.0)
    tone = np.array([np.interp(k, np.arange(len(_MONK)), channel) for channel in scale.T])
    red = rng.uniform(0.0, 0.16)
    c = np.clip(tone * [1.0 + 0.3 * red, 1.0 - red, 1.0 - red] + rng.normal(0.0, 0.015, 3), 0.0, 1.0)
    return float(c[0]), float(c[1]), float(c[2])


def any_glove_color(rng: np.random.Generator) -> Color:
    """A random colour of a glove, sRGB in [0, 1]: a usual one, varied, or any."""
    if rng.random() < 0.3:
        return any_color(rng)
    c = np.clip(np.array(_GLOVES[int(rng.integers(len(_GLOVES)))]) + rng.normal(0.0, 0.06, 3), 0.0, 1.0)
    return float(c[0]), float(c[1]), float(c[2])


def any_color(rng: np.random.Generator) -> Color:
    """A random colour, sRGB in [0, 1]; nearly grey with probability 0.5, as many objects in a workshop are."""
    value = rng.uniform(0.03, 0.95)
    saturation = rng.uniform(0.0, 0.12) if rng.random() < 0.5 else rng.uniform(0.2, 0.9)
    hue = rng.uniform(0.0, 6.0)
    tint = np.clip(np.abs((hue + np.array([0.0, 4.0, 2.0])) % 6.0 - 3.0) - 1.0, 0.0, 1.0)
    c = value * (1.0 - saturation * (1.0 - tint))
    return float(c[0]), float(c[1]), float(c[2])
