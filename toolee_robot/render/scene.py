"""Scene description of the renderer: bodies, lights and environment, all in the world frame."""

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
