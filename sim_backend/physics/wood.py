"""How wood resists a nail that is driven into it.

    F(depth) = tip + shank * depth,   and the head's bearing on the wood once it touches

- `shank`: the withdrawal resistance of a bright, smooth nail driven into side grain, p = 54.12 G^(5/2) D L
  [N, mm, mm] (Forest Products Laboratory, Wood Handbook, FPL-GTR-282, chapter 8), taken as the sliding friction
  while driving. The handbook finds that a lead hole of up to nine tenths of the shank leaves this resistance as it is
  (slightly higher), so a pilot hole does not lower it here either, except where it is wider than that.
- `tip`: the force that opens the way for the point. An estimate: 150 N for a 3 mm nail in pine of G = 0.42 and no
  hole, growing with the area of wood pushed aside and with G^(5/2). A pilot hole takes its own area off.
- head: pull-through strength f_head = 70e-6 rho^2 [MPa, kg/m^3] (EN 1995-1-1, 8.3.2) on the head's area.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.config import WorkConfig
from toolee_robot.errors import ConfigError

WITHDRAWAL = 54.12e6  # [Pa] of friction force per (diameter x depth) at G = 1
TIP_PRESSURE = 150.0 / 0.003**2 / 0.42**2.5  # [Pa] of tip force per squared diameter at G = 1; an estimate
WIDEST_TIGHT_HOLE = 0.9  # pilot hole over shank diameter up to which the friction is that without a hole
HEAD_CRUSH_DEPTH = 0.3e-3  # [m] of indentation at which the wood under the head yields fully
WATER_DENSITY = 1000.0  # [kg/m^3]


@dataclass(frozen=True)
class NailSpec:
    """A wire nail and its wood. Lengths [m].

    length: overall, from the head's top to the tip. protrusion: how far the head's top stands over the wood at first.
    specific_gravity: the wood's oven-dry mass over the mass of as much water (pine 0.42, oak 0.68).
    pilot_diameter: of the hole drilled before, as deep as the nail is long; 0 for none.
    tensile_strength [Pa]: of the wire, for the plastic moment.
    """

    diameter: float = 0.0022
    length: float = 0.030
    head_diameter: float = 0.006
    head_thickness: float = 0.0008
    protrusion: float = 0.020
    specific_gravity: float = 0.35
    pilot_diameter: float = 0.0015
    tensile_strength: float = 600e6

    def __post_init__(self) -> None:
        if not 0.0005 <= self.diameter <= 0.008:
            raise ConfigError(f"nail diameter {self.diameter} m: give metres, 0.0005 to 0.008")
        if not self.diameter < self.head_diameter <= 0.03:
            raise ConfigError(f"nail head {self.head_diameter} m: it must be wider than the shank, at most 0.03 m")
        if not 0 <= self.pilot_diameter < self.diameter:
            raise ConfigError(f"pilot hole {self.pilot_diameter} m: must be narrower than the nail ({self.diameter})")
        if not 0.1 <= self.specific_gravity <= 1.2:
            raise ConfigError(f"specific gravity {self.specific_gravity}: woods lie between 0.1 and 1.2 (pine 0.42)")
        if not 0 < self.head_thickness < self.protrusion < self.length:
            raise ConfigError(
                f"protrusion {self.protrusion} m must lie between the head's thickness ({self.head_thickness}) and the "
                f"nail's length ({self.length}): start the nail in the wood"
            )

    @classmethod
    def from_config(cls, work: WorkConfig) -> NailSpec:
        """The nail and wood of a station."""
        return cls(
            diameter=work.nail_diameter,
            length=work.nail_length,
            head_diameter=work.nail_head_diameter,
            protrusion=work.nail_protrusion,
            specific_gravity=work.wood_specific_gravity,
            pilot_diameter=work.pilot_hole_diameter,
        )

    @property
    def plastic_moment(self) -> float:
        """Moment [Nm] at which the shank bends for good: 0.3 f_u d^2.6 [N, mm] (EN 1995-1-1, 8.14)."""
        return float(0.3 * (self.tensile_strength * 1e-6) * (self.diameter * 1e3) ** 2.6 * 1e-3)


def shank_friction(spec: NailSpec) -> float:
    """Friction per depth [N/m]."""
    friction = WITHDRAWAL * spec.specific_gravity**2.5 * spec.diameter
    ratio = spec.pilot_diameter / spec.diameter
    return float(friction * min((1 - ratio) / (1 - WIDEST_TIGHT_HOLE), 1.0))


def tip_force(spec: NailSpec) -> float:
    """Force that opens the way for the point [N]."""
    return float(TIP_PRESSURE * spec.specific_gravity**2.5 * (spec.diameter**2 - spec.pilot_diameter**2))


def head_force(spec: NailSpec, protrusion: float) -> float:
    """Bearing of the wood under the head [N]: none until the head's underside is down (protrusion = its thickness),
    then rising to the pull-through strength times the head's area."""
    strength = 70e-6 * (spec.specific_gravity * WATER_DENSITY) ** 2 * 1e6
    area = np.pi / 4 * (spec.head_diameter**2 - spec.diameter**2)
    indentation = (spec.head_thickness - protrusion) / HEAD_CRUSH_DEPTH
    return float(strength * area * min(max(indentation, 0.0), 1.0))


def resistance(spec: NailSpec, protrusion: float) -> float:
    """Force [N] that drives the nail further when its head's top stands `protrusion` [m] over the wood."""
    depth = max(spec.length - protrusion, 0.0)
    return tip_force(spec) + shank_friction(spec) * depth + head_force(spec, protrusion)


def driving_work(spec: NailSpec, start: float, end: float) -> float:
    """Energy [J] to drive from protrusion `start` to `end` [m]: the integral of `resistance`."""

    def head(protrusion: float) -> float:
        """Integral of the head's bearing down to `protrusion`."""
        indentation = max((spec.head_thickness - protrusion) / HEAD_CRUSH_DEPTH, 0.0)
        crushed = indentation**2 / 2 if indentation < 1 else indentation - 0.5
        return head_force(spec, -np.inf) * HEAD_CRUSH_DEPTH * crushed

    tip = tip_force(spec) * (start - end)
    shank = shank_friction(spec) * ((spec.length - end) ** 2 - (spec.length - start) ** 2) / 2
    return float(tip + shank + head(end) - head(start))
