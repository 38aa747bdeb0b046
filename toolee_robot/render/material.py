"""What is rendered: materials and colours, and the scene of bodies, lights and environment in the world frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from toolee_robot.frames import Array
from toolee_robot.render.kernels import surroundings
from toolee_robot.render.mesh import FloatArray, Mesh


class Pattern(StrEnum):
    """Procedural patterns that mix the two colours of a material."""

    SOLID = "solid"
    CLOUD = "cloud"
    WOOD = "wood"
    STRIPES = "stripes"
    CHECKER = "checker"
    SPECKLE = "speckle"
    SCRATCHES = "scratches"
    PLANKS = "planks"
    TILES = "tiles"


@dataclass(frozen=True)
class Material:
    """A surface material.

    Attributes:
        color: First colour, linear RGB in [0, 1].
        color2: Second colour, linear RGB in [0, 1].
        pattern: Pattern of the two colours.
        scale: Feature size of the pattern [m].
        axis: Body axis (0, 1, 2) of grain, stripes and scratches.
        roughness: Roughness in [0, 1].
        metallic: Metalness in [0, 1].
        wear: Strength of large-scale dirt in [0, 1].
        offset: Offset of the pattern in the body frame [m]; it makes equal bodies differ.
    """

    color: tuple[float, float, float] = (0.6, 0.6, 0.6)
    color2: tuple[float, float, float] = (0.4, 0.4, 0.4)
    pattern: Pattern = Pattern.SOLID
    scale: float = 0.02
    axis: int = 2
    roughness: float = 0.6
    metallic: float = 0.0
    wear: float = 0.0
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def row(self) -> tuple[Any, ...]:
        """Values of the material fields, the last ones, of `kernels.surroundings.Surface`."""
        pattern = _PATTERNS[self.pattern]
        colors = (self.color, self.color2, self.offset)
        return (*colors, pattern, self.axis, 1.0 / self.scale, self.roughness, self.metallic, self.wear)


_PATTERNS = {pattern: getattr(surroundings, pattern.name) for pattern in Pattern}


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


_CAP = 0.012
"""Faces within this distance [m] of the closed end of a joint housing belong to the cap."""


@dataclass(frozen=True, eq=False)
class LookPart:
    """A part of a link in one colour.

    Attributes:
        mesh: Mesh in the link frame [m].
        color: Colour, sRGB in [0, 1].
        roughness: Roughness in [0, 1].
        metallic: Metalness in [0, 1].
        finish: Name of the surface for `finish`.
    """

    mesh: Mesh
    color: tuple[float, float, float]
    roughness: float
    metallic: float
    finish: str


# Link -> closed ends of its joint housings: (axis, side, lower and upper bound along the link's z [m]).
_CAPS: dict[str, tuple[tuple[int, int, float, float], ...]] = {
    "shoulder_link": ((1, -1, -0.1, 0.1),),
    "upper_arm_link": ((1, -1, -0.1, 0.1), (1, -1, 0.55, 0.70)),
    "forearm_link": ((1, 1, -0.08, 0.08), (1, 1, 0.54, 0.65)),
    "wrist_1_link": ((2, -1, -0.1, 0.1),),
    "wrist_2_link": ((1, -1, 0.0, 0.2),),
}
_GREY, _BLUE, _DARK = (0.76, 0.77, 0.78), (0.36, 0.56, 0.72), (0.17, 0.17, 0.18)


def arm_link_parts(link: str, vertices: object, faces: object) -> tuple[LookPart, ...]:
    """Divide a link of the UR10 into coloured parts.

    Args:
        link: Name of the link.
        vertices: Vertices, link frame, (V, 3) [m].
        faces: Indices of each triangle's vertices, (F, 3).

    Returns:
        The parts.
    """
    v = np.asarray(vertices, np.float32)
    f = np.asarray(faces, np.int32)
    if link in ("base_link", "wrist_3_link", "tool0"):
        return (LookPart(Mesh.build(v, f), _DARK if link != "base_link" else _GREY, 0.4, 0.5, "aluminium"),)
    centre = v[f].mean(axis=1)
    cap = np.zeros(len(f), bool)
    for axis, side, low, high in _CAPS.get(link, ()):
        inside = (centre[:, 2] >= low) & (centre[:, 2] <= high)
        if inside.any():
            reach = side * centre[:, axis]
            cap |= inside & (reach > reach[inside].max() - _CAP)
    parts = []
    if (~cap).any():
        parts.append(LookPart(Mesh.build(v, f[~cap]), _GREY, 0.35, 0.3, "painted_metal"))
    if cap.any():
        parts.append(LookPart(Mesh.build(v, f[cap]), _BLUE, 0.4, 0.0, "plastic"))
    return tuple(parts)


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid mesh with a material.

    Attributes:
        mesh: Mesh in the body frame [m].
        X_world_body: Pose of the body in the world frame, 4x4 [m].
        material: Surface material.
        body_id: Value of its pixels in `Rendering.body_ids`, 0..32766; several bodies may share an id.
    """

    mesh: Mesh
    X_world_body: Array
    material: Material = field(default_factory=Material)
    body_id: int = 0


@dataclass(frozen=True)
class Light:
    """A lamp, either distant (with a direction) or near (with a position).

    Attributes:
        color: Linear RGB radiance at the surface; for a near lamp, at a distance of 1 m.
        direction: Unit vector (3,) towards a distant lamp, world frame.
        position: Position (3,) [m] of a near lamp, world frame.
        softness: Half-angle [rad] of a distant lamp or radius [m] of a near lamp; it blurs the shadow.
        shadow: Whether the lamp casts shadows.

    Raises:
        ValueError: Neither or both of direction and position are given.
    """

    color: tuple[float, float, float]
    direction: tuple[float, float, float] | None = None
    position: tuple[float, float, float] | None = None
    softness: float = 0.03
    shadow: bool = True

    def __post_init__(self) -> None:
        if (self.direction is None) == (self.position is None):
            raise ValueError("a light needs a direction or a position, not both")


@dataclass(frozen=True)
class Lobe:
    """A bright region of the environment, such as a window or a lamp.

    Attributes:
        direction: Unit vector (3,) towards its centre, world frame.
        width: Half-width [rad].
        color: Linear RGB.
    """

    direction: tuple[float, float, float]
    width: float
    color: tuple[float, float, float]


@dataclass(frozen=True)
class Environment:
    """Ambient light, a vertical gradient (world z is up) with bright regions.

    Attributes:
        zenith: Linear RGB from above.
        horizon: Linear RGB from the horizon.
        ground: Linear RGB from below.
        lobes: Bright regions.
    """

    zenith: tuple[float, float, float] = (0.55, 0.58, 0.62)
    horizon: tuple[float, float, float] = (0.40, 0.40, 0.40)
    ground: tuple[float, float, float] = (0.18, 0.17, 0.16)
    lobes: tuple[Lobe, ...] = ()


@dataclass(frozen=True)
class Patch:
    """An ellipse or a rectangle of one colour in an image.

    Attributes:
        centre: x and y of the centre [image widths].
        half_axes: Half axes [image widths].
        angle: Angle between the first half axis and x [rad].
        oval: Whether it is an ellipse.
        color: Linear RGB.
    """

    centre: tuple[float, float]
    half_axes: tuple[float, float]
    angle: float
    oval: bool
    color: tuple[float, float, float]


@dataclass(frozen=True)
class Backdrop:
    """A background image without depth: a linear gradient with patches.

    Attributes:
        corner: Linear RGB in the upper left corner.
        right: Change of the colour over one image width to the right.
        down: Change of the colour over one image width downwards.
        patches: Patches, the last one on top.
    """

    corner: tuple[float, float, float]
    right: tuple[float, float, float]
    down: tuple[float, float, float]
    patches: tuple[Patch, ...] = ()


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene to be rendered.

    Attributes:
        bodies: Bodies in the world frame.
        lights: Lamps.
        environment: Ambient light.
        background: Image where no body is hit; None: the environment.
    """

    bodies: Sequence[Body]
    lights: Sequence[Light] = ()
    environment: Environment = field(default_factory=Environment)
    background: Backdrop | None = None


@dataclass(frozen=True, eq=False)
class Rendering:
    """A rendered image.

    Attributes:
        rgb: Colour (H, W, 3), sRGB.
        depth: Depth along the optical axis (H, W) [m]; 0 where nothing is hit.
        body_ids: `Body.body_id` (H, W); -1 where nothing is hit.
        cos_incidence: Cosine of the angle between ray and surface normal (H, W), in [0, 1].
        shininess: Share of specular reflection (H, W), in [0, 1].
    """

    rgb: NDArray[np.uint8]
    depth: FloatArray
    body_ids: NDArray[np.int16]
    cos_incidence: FloatArray
    shininess: FloatArray
