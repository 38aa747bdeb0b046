"""Colours of the links of a UR arm, assigned by geometry: light grey tubes, dark flange, blue end caps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.render.mesh import Mesh

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
        finish: Name of the surface for `palette.finish`.
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
