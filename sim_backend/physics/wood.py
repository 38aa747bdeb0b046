"""Resistance of wood against a nail that is driven into it.

    F(depth) = tip + shank * depth, plus the head's bearing force once it touches the wood

- `shank`: the withdrawal resistance of a bright, smooth nail driven into side grain, p = 54.12 G^(5/2) D L
  [N, mm, mm] (Forest Products Laboratory, Wood Handbook, FPL-GTR-282, chapter 8), taken as the sliding friction
  while driving. According to the handbook a lead hole of up to nine tenths of the shank does not reduce this resistance
  (it is slightly higher), so neither does a pilot hole here, unless it is wider than that.
- `tip`: the force that the point needs to push the wood aside. An estimate: 150 N for a 3 mm nail in pine of G = 0.42
  without a hole, proportional to the displaced area and to G^(5/2). A pilot hole reduces the displaced area.
- head: pull-through strength f_head = 70e-6 rho^2 [MPa, kg/m^3] (EN 1995-1-1, 8.3.2) on the head's area.

A nail that is bent where it enters the wood resists more (`bend_resistance`): the wood's walls, which turn it into its
hole, press on it and rub, and its wire is bent and straightened on the way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.errors import ConfigError
from toolee_robot.station import WorkConfig

WITHDRAWAL = 54.12e6  # [Pa] friction force per (diameter x depth) at G = 1
TIP_PRESSURE = 150.0 / 0.003**2 / 0.42**2.5  # [Pa] tip force per squared diameter at G = 1; an estimate
WIDEST_TIGHT_HOLE = 0.9  # ratio of pilot hole to shank diameter up to which the friction is that without a hole
WALL_FRICTION = 0.3  # coefficient of friction of a nail's wire on wood; an estimate
STEEL = 210e9  # [Pa] elastic modulus of the wire
HEAD_CRUSH_DEPTH = 0.3e-3  # [m] indentation at which the wood under the head yields fully
WATER_DENSITY = 1000.0  # [kg/m^3]


@dataclass(frozen=True)
class NailSpec:
    """A wire nail and its wood.

    Attributes:
        diameter: Diameter of the shank [m].
        length: Overall length, from the head's top to the tip [m].
        head_diameter: Diameter of the head [m].
        head_thickness: Thickness of the head [m].
        protrusion: Initial height of the head's top over the wood [m].
        specific_gravity: Oven-dry mass of the wood over the mass of the same volume of water (pine 0.42, oak 0.68).
        pilot_diameter: Diameter of the pilot hole, which is as deep as the nail is long [m]; 0 for none.
        tensile_strength: Tensile strength of the wire [Pa], for the plastic moment.
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
            raise ConfigError(
                f"nail diameter {self.diameter} m: give metres, 0.0005 to 0.008", code="config.nail_diameter"
            )
        if not self.diameter < self.head_diameter <= 0.03:
            message = f"nail head {self.head_diameter} m: it must be wider than the shank, at most 0.03 m"
            raise ConfigError(message, code="config.nail_head")
        if not 0 <= self.pilot_diameter < self.diameter:
            message = f"pilot hole {self.pilot_diameter} m: must be narrower than the nail ({self.diameter})"
            raise ConfigError(message, code="config.pilot_hole")
        if not 0.1 <= self.specific_gravity <= 1.2:
            message = f"specific gravity {self.specific_gravity}: woods lie between 0.1 and 1.2 (pine 0.42)"
            raise ConfigError(message, code="config.specific_gravity")
        if not 0 < self.head_thickness < self.protrusion < self.length:
            raise ConfigError(
                f"protrusion {self.protrusion} m must lie between the head's thickness ({self.head_thickness}) and the "
                f"nail's length ({self.length}): start the nail in the wood",
                code="config.nail_protrusion",
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
        """Moment at which the shank bends permanently [Nm]: 0.3 f_u d^2.6 [N, mm] (EN 1995-1-1, 8.14)."""
        return float(0.3 * (self.tensile_strength * 1e-6) * (self.diameter * 1e3) ** 2.6 * 1e-3)


def shank_friction(spec: NailSpec) -> float:
    """Friction force per depth [N/m]."""
    friction = WITHDRAWAL * spec.specific_gravity**2.5 * spec.diameter
    ratio = spec.pilot_diameter / spec.diameter
    return float(friction * min((1 - ratio) / (1 - WIDEST_TIGHT_HOLE), 1.0))


def tip_force(spec: NailSpec) -> float:
    """Force that the point needs to push the wood aside [N]."""
    return float(TIP_PRESSURE * spec.specific_gravity**2.5 * (spec.diameter**2 - spec.pilot_diameter**2))


def embedding_strength(spec: NailSpec) -> float:
    """Pressure on the wire's width at which the wood beside it yields [Pa] (EN 1995-1-1, 8.15 and 8.16)."""
    millimetres, density = spec.diameter * 1e3, spec.specific_gravity * WATER_DENSITY
    factor = 1 - 0.01 * millimetres if spec.pilot_diameter > 0 else millimetres**-0.3
    return 0.082e6 * density * factor


def bend_resistance(spec: NailSpec, bend: float) -> float:
    """Additional force that drives a nail which is bent where it enters the wood.

    The wood turns the wire into its hole over the length b at which a couple of its yielding walls holds the plastic
    moment M, M = f d b^2 with the embedding strength f and the diameter d. The walls press with 2 f d b in all, in
    proportion to the bend below the elastic limit M b / (E I), and rub. Beyond that limit the wire is bent and
    straightened: 2 M / b per radian.

    Args:
        spec: Nail and wood.
        bend: Angle between the nail and its hole [rad].

    Returns:
        The force [N].
    """
    load = embedding_strength(spec) * spec.diameter
    length = np.sqrt(spec.plastic_moment / load)
    elastic = spec.plastic_moment * length / (STEEL * np.pi * spec.diameter**4 / 64)
    rubbing = WALL_FRICTION * 2 * load * length * min(bend / elastic, 1.0)
    return float(rubbing + 2 * spec.plastic_moment / length * max(bend - elastic, 0.0))


def head_force(spec: NailSpec, protrusion: float) -> float:
    """Bearing force of the wood under the head.

    Zero until the head's underside touches the wood (protrusion = its thickness), then rising to the pull-through
    strength times the head's area.

    Args:
        spec: Nail and wood.
        protrusion: Height of the head's top over the wood [m].

    Returns:
        The force [N].
    """
    strength = 70e-6 * (spec.specific_gravity * WATER_DENSITY) ** 2 * 1e6
    area = np.pi / 4 * (spec.head_diameter**2 - spec.diameter**2)
    indentation = (spec.head_thickness - protrusion) / HEAD_CRUSH_DEPTH
    return float(strength * area * min(max(indentation, 0.0), 1.0))


def resistance(spec: NailSpec, protrusion: float, bend: float = 0.0) -> float:
    """Force that drives the nail further.

    Args:
        spec: Nail and wood.
        protrusion: Height of the head's top over the wood [m].
        bend: Angle between the nail and its hole [rad].

    Returns:
        The force [N].
    """
    depth = max(spec.length - protrusion, 0.0)
    straight = tip_force(spec) + shank_friction(spec) * depth + head_force(spec, protrusion)
    return straight + (bend_resistance(spec, bend) if bend > 0.0 else 0.0)


def driving_work(spec: NailSpec, start: float, end: float, bend: float = 0.0) -> float:
    """Energy needed to drive the nail: the integral of `resistance`.

    Args:
        spec: Nail and wood.
        start: Protrusion at the start [m].
        end: Protrusion at the end [m].
        bend: Angle between the nail and its hole [rad].

    Returns:
        The energy [J].
    """

    def head(protrusion: float) -> float:
        """Integral of the head's bearing force down to `protrusion`."""
        indentation = max((spec.head_thickness - protrusion) / HEAD_CRUSH_DEPTH, 0.0)
        crushed = indentation**2 / 2 if indentation < 1 else indentation - 0.5
        return head_force(spec, -np.inf) * HEAD_CRUSH_DEPTH * crushed

    tip = tip_force(spec) * (start - end)
    shank = shank_friction(spec) * ((spec.length - end) ** 2 - (spec.length - start) ** 2) / 2
    bent = bend_resistance(spec, bend) * (start - end) if bend > 0.0 else 0.0
    return float(tip + shank + head(end) - head(start) + bent)
