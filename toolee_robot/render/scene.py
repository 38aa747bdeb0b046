"""What the renderer draws: bodies, lights and surroundings, all in the world frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from toolee_robot.frames import Array
from toolee_robot.render.material import Material
from toolee_robot.render.mesh import FloatArray, Mesh


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid mesh at X_world_body (4x4). body_id (0..32766) is what `Rendering.body_ids` shows; several bodies may
    share one."""

    mesh: Mesh
    X_world_body: Array
    material: Material = field(default_factory=Material)
    body_id: int = 0


@dataclass(frozen=True)
class Light:
    """A lamp. direction (3,): unit, towards the lamp, if it is far; position (3,) [m], if it is near (give one).
    color: radiance at the surface, at 1 m for a near lamp. softness: half-angle [rad] (radius [m]) of a far (near)
    lamp, blurs its shadow; shadow: whether it casts one."""

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
    """A bright patch of the surroundings (a window, a lamp): direction (3,) unit, half-width [rad], linear RGB."""

    direction: tuple[float, float, float]
    width: float
    color: tuple[float, float, float]


@dataclass(frozen=True)
class Environment:
    """The light from all around: linear RGB overhead, at the horizon and from below (world z is up), and patches."""

    zenith: tuple[float, float, float] = (0.55, 0.58, 0.62)
    horizon: tuple[float, float, float] = (0.40, 0.40, 0.40)
    ground: tuple[float, float, float] = (0.18, 0.17, 0.16)
    lobes: tuple[Lobe, ...] = ()


@dataclass(frozen=True)
class Patch:
    """An ellipse (oval) or a rectangle of one colour in an image. centre, half_axes: x and y in widths of the image;
    angle: of the first half axis against x [rad]. color: linear RGB."""

    centre: tuple[float, float]
    half_axes: tuple[float, float]
    angle: float
    oval: bool
    color: tuple[float, float, float]


@dataclass(frozen=True)
class Backdrop:
    """A flat picture behind everything, without depth: linear RGB in the image's upper left corner, what is added to it
    over one width of the image to the right and down, and patches, the last one on top."""

    corner: tuple[float, float, float]
    right: tuple[float, float, float]
    down: tuple[float, float, float]
    patches: tuple[Patch, ...] = ()


@dataclass(frozen=True, eq=False)
class Scene:
    """background: shown where no body is hit; None for the environment itself."""

    bodies: Sequence[Body]
    lights: Sequence[Light] = ()
    environment: Environment = field(default_factory=Environment)
    background: Backdrop | None = None


@dataclass(frozen=True, eq=False)
class Rendering:
    """rgb (H, W, 3) uint8 sRGB. depth (H, W) float32 [m] along the optical axis, 0 where nothing is hit.
    body_ids (H, W) int16, -1 where nothing is hit. cos_incidence (H, W) float32 in [0, 1]: cosine between the ray and
    the surface's normal. shininess (H, W) float32 in [0, 1]: how much of the light is reflected as by a mirror."""

    rgb: NDArray[np.uint8]
    depth: FloatArray
    body_ids: NDArray[np.int16]
    cos_incidence: FloatArray
    shininess: FloatArray
