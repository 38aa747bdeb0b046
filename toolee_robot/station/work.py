"""The work: the wooden block on its stand, and the nails in it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from toolee_robot.frames import Array, angle_between, frame_from_axes
from toolee_robot.station.schema import (
    STRICT,
    Extent,
    Gravity,
    Hole,
    NailHead,
    Place,
    Protrusion,
    Shank,
    ShankLength,
    Slope,
)
from toolee_robot.types.units import Metres, Radians

ONLY_NAIL = "nail"
"""Name of the nail of a station whose file gives one without a name."""
SIZES = ("diameter", "length", "head_diameter", "protrusion", "lean")
"""Fields of a nail of `work.nails` that `work.nail_...` give for all."""
LARGEST_TILT = float(np.deg2rad(10.0))
"""Largest angle of the wood's normal and of a nail's axis to the vertical, and to each other [rad]; more is refused."""
LEAST_STAND = 0.001
"""Height of the stand of a block that stands on the table itself [m]."""


@dataclass(frozen=True)
class NailConfig:
    """One of several nails: its name, its place, and where it differs from what `work` says of all."""

    __pydantic_config__ = STRICT
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,32}$")]
    """Name of the nail in the summary, on the terminal and for `--nail`: letters, digits, - and _."""
    xy: tuple[Place, Place]
    """Position of the nail's axis in `base`, x and y."""
    diameter: Shank | None = None
    """Diameter of its shank; null for `work.nail_diameter`."""
    length: ShankLength | None = None
    """Length of its shank; null for `work.nail_length`."""
    head_diameter: NailHead | None = None
    """Diameter of its head; null for `work.nail_head_diameter`."""
    protrusion: Protrusion | None = None
    """Height of its head above the wood before the first strike; null: `work.nail_protrusion`."""
    pilot_hole_diameter: Hole | None = None
    """Diameter of its predrilled hole, 0 for none; null for `work.pilot_hole_diameter`."""
    lean: tuple[Slope, Slope] | None = None
    """Its lean; null: `work.nail_lean`."""


@dataclass(frozen=True)
class WorkConfig:
    """The wooden block on its stand, and the nail or nails. Strikes and touches go along the nail's axis.

    Heights are over the base plane. The wood is level and the nail upright unless `wood_rise` and `nail_lean` say
    otherwise, up to 10 degrees from the vertical and from each other. A held claw hammer of 0.9 kg at 1.5 m/s, which
    hits far from its centre of mass, delivers about 0.45 J per strike.

    The fields `nail_...` and `pilot_hole_diameter` are about one nail; where `nails` lists several, about the first of
    them, or the one that `only` picks.
    """

    __pydantic_config__ = STRICT
    nail_xy: tuple[Place, Place]
    """Position of the nail's axis in `base`, x and y; left out if `nails` lists several."""
    stand_height: Annotated[float, Metres(-3.0, 3.0)]
    """Height above the base plane of the surface under the block: the stand's top, or the table's top without a
    stand.
    """
    stand_size: tuple[Extent, Extent]
    """Size of the stand, x and y."""
    block_size: tuple[Extent, Extent, Extent]
    """Size of the block, x, y and z."""
    nail_diameter: Shank
    """Diameter of the nail's shank."""
    nail_length: ShankLength
    """Length of the nail's shank."""
    nail_head_diameter: NailHead
    """Diameter of the nail's head."""
    nail_protrusion: Protrusion
    """Height of the nail's head above the wood before the first strike."""
    wood_specific_gravity: Gravity
    """Specific gravity of the wood: white pine 0.35, Scots pine 0.42, oak 0.68."""
    pilot_hole_diameter: Hole
    """Diameter of the predrilled hole; 0 for none."""
    nails: tuple[NailConfig, ...] = ()
    """Several nails, in the order in which they are driven; empty: the one of `nail_xy`."""
    block_xy: tuple[Place, Place] | None = None
    """Middle of block and stand in `base`, x and y; null for the middle between the outermost nails."""
    block_turn: Annotated[float, Radians(-1.5708, 1.5708, "a quarter turn")] = 0.0
    """Rotation of block and stand about the vertical; 0: edges parallel to x and y."""
    wood_rise: tuple[Slope, Slope] = (0.0, 0.0)
    """Slope of the wood's top along x and y of `base`, metres per metre: (0, 0) is level, 0.0175 is 1 degree.
    `stand_height` is then the height below the middle of the block.
    """
    nail_lean: tuple[Slope, Slope] = (0.0, 0.0)
    """Lean of the nail against the wood's normal, along x and y of `base`, metres per metre of its height. Measure
    it with a set square on the wood.
    """

    def __post_init__(self) -> None:
        if self.nails:
            object.__setattr__(self, "nails", tuple(self._complete(nail) for nail in self.nails))
            names = [nail.name for nail in self.nails]
            if len(set(names)) < len(names):
                raise ValueError(f"nails {', '.join(names)}: give each nail its own name")
            if all(nail.xy != self.nail_xy for nail in self.nails):
                raise ValueError(f"nail_xy {self.nail_xy} belongs to none of `nails`: leave it out")
        if (tilt := angle_between(self.wood_normal, np.array([0.0, 0.0, 1.0]))) > LARGEST_TILT:
            raise ValueError(
                f"wood_rise {self.wood_rise} is {np.rad2deg(tilt):.1f} degrees, at most "
                f"{np.rad2deg(LARGEST_TILT):.0f} are allowed. Unit: metres per metre, 0.0175 for 1 degree"
            )
        for nail in self.all_nails:
            self._check(nail)
        for a, b in combinations(self.all_nails, 2):
            if np.allclose(a.xy, b.xy, atol=1e-6):
                raise ValueError(f"the nails {a.name} and {b.name} have the same place")

    def _complete(self, nail: NailConfig) -> NailConfig:
        given = {name: getattr(nail, name) or getattr(self, f"nail_{name}") for name in SIZES}
        hole = self.pilot_hole_diameter if nail.pilot_hole_diameter is None else nail.pilot_hole_diameter
        return replace(nail, **given, pilot_hole_diameter=hole)

    def _check(self, nail: NailConfig) -> None:
        whose = f"nail {nail.name}: " if self.nails else ""
        assert nail.protrusion is not None
        assert nail.length is not None
        assert nail.diameter is not None
        assert nail.pilot_hole_diameter is not None
        if nail.protrusion > nail.length:
            raise ValueError(f"{whose}nail_protrusion {nail.protrusion} is more than nail_length {nail.length}")
        if nail.pilot_hole_diameter >= nail.diameter:
            raise ValueError(
                f"{whose}pilot_hole_diameter {nail.pilot_hole_diameter} does not hold nail_diameter {nail.diameter}"
            )
        if (tilt := angle_between(self._axis(nail.lean or (0.0, 0.0)), np.array([0.0, 0.0, 1.0]))) > LARGEST_TILT:
            raise ValueError(
                f"{whose}wood_rise {self.wood_rise} and nail_lean {nail.lean} tilt it by {np.rad2deg(tilt):.1f} "
                f"degrees, at most {np.rad2deg(LARGEST_TILT):.0f} are allowed. Unit: m/m, 0.0175 for 1 degree"
            )
        if (lean := angle_between(self._axis(nail.lean or (0.0, 0.0)), self.wood_normal)) > LARGEST_TILT:
            raise ValueError(
                f"{whose}nail_lean {nail.lean} is {np.rad2deg(lean):.1f} degrees off the wood's normal, at most "
                f"{np.rad2deg(LARGEST_TILT):.0f} are allowed. Unit: metres per metre, 0.0175 for 1 degree"
            )
        (cos, sin, _), away = self._along, np.subtract(nail.xy, self.block_center)
        off = np.abs(np.array([[cos, sin], [-sin, cos]]) @ away)
        if np.any(off > np.array(self.block_size[:2]) / 2):
            x, y = self.block_center
            raise ValueError(
                f"{whose}({nail.xy[0]}, {nail.xy[1]}) is outside the block, which is {self.block_size[0]} x "
                f"{self.block_size[1]} m around ({x:.4f}, {y:.4f}): check block_size, block_xy and block_turn"
            )

    @property
    def wood_height(self) -> float:
        """Height of the middle of the block's top over the base plane [m]."""
        return self.stand_height + self.block_size[2]

    @property
    def wood_normal(self) -> Array:
        """Normal of the block's top, out of the wood, `base`, (3,)."""
        return self._axis((0.0, 0.0))

    @property
    def X_base_block(self) -> Array:
        """Pose of the block's centre in `base`, (4, 4): z is the wood's normal."""
        n, half = self.wood_normal, self.block_size[2] / 2
        x, y = self.block_center
        # The middle of its top stays where it is, whatever the tilt.
        p = [x - n[0] * half, y - n[1] * half, self.stand_height + half + (1.0 - n[2]) * half]
        return frame_from_axes(z=n, x=self._along, p=p)

    def stand_box(self, table_height: float) -> tuple[Array, tuple[float, float, float]]:
        """The box that the stand fills.

        Args:
            table_height: Height of the table's top, on which it stands, over the base plane [m].

        Returns:
            Pose of its centre in `base`, (4, 4), and its edge lengths [m]; it is never lower than LEAST_STAND.
        """
        height = max(self.stand_height - table_height, LEAST_STAND)
        x, y = self.block_center
        up = np.array([0.0, 0.0, 1.0])
        X = frame_from_axes(z=up, x=self._along, p=[x, y, self.stand_height - height / 2])
        return X, (*self.stand_size, height)

    @property
    def _along(self) -> Array:
        """Horizontal direction of the block's x edges, (3,)."""
        return np.array([np.cos(self.block_turn), np.sin(self.block_turn), 0.0])

    @property
    def nail_axis(self) -> Array:
        """Axis of the nail, out of the wood, `base`, (3,)."""
        return self._axis(self.nail_lean)

    @property
    def p_base_entry(self) -> Array:
        """Where the nail's axis meets the wood's surface, `base`, (3,) [m]."""
        away = np.subtract(self.nail_xy, self.block_center)
        return np.array([*self.nail_xy, self.wood_height + float(np.dot(self.wood_rise, away))])

    def _axis(self, lean: tuple[float, float]) -> Array:
        """Unit vector out of the wood of a nail with that lean, (3,)."""
        v = np.array([*np.subtract(lean, self.wood_rise), 1.0])
        return np.asarray(v / np.linalg.norm(v))

    @property
    def block_center(self) -> tuple[float, float]:
        """Middle of block and stand in `base`, x and y [m]."""
        if self.block_xy is not None:
            return self.block_xy
        places = np.array([nail.xy for nail in self.nails] or [self.nail_xy])
        x, y = ((places.min(axis=0) + places.max(axis=0)) / 2).tolist()
        return x, y

    @property
    def all_nails(self) -> tuple[NailConfig, ...]:
        """Every nail with all its sizes, in the order in which they are driven; one where there is one."""
        return self.nails or (self._complete(NailConfig(ONLY_NAIL, self.nail_xy)),)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the nails, in the order in which they are driven."""
        return tuple(nail.name for nail in self.all_nails)

    def only(self, name: str) -> WorkConfig:
        """Make the fields `nail_...` about one of the nails; the others stay where they are.

        Args:
            name: Its name.

        Returns:
            The work.

        Raises:
            KeyError: There is no such nail.
        """
        nail = {nail.name: nail for nail in self.all_nails}[name]
        sizes: dict[str, Any] = {f"nail_{field}": getattr(nail, field) for field in SIZES}
        sizes["pilot_hole_diameter"] = nail.pilot_hole_diameter
        return replace(self, nail_xy=nail.xy, **sizes)

    @property
    def others(self) -> tuple[WorkConfig, ...]:
        """The work about each of the nails that the fields `nail_...` are not about."""
        return tuple(self.only(nail.name) for nail in self.all_nails if nail.xy != self.nail_xy)

    def each(self) -> Iterator[tuple[str, WorkConfig]]:
        """Go through the nails.

        Yields:
            Name of a nail, and the work about it.
        """
        for name in self.names:
            yield name, self.only(name)

    def moved(self, dx: float, dy: float, dz: float) -> WorkConfig:
        """Move the block with its nails.

        Args:
            dx: Way along x of `base` [m].
            dy: Way along y [m].
            dz: Way along z [m].

        Returns:
            The work there.
        """

        def there(xy: tuple[float, float]) -> tuple[float, float]:
            return float(xy[0] + dx), float(xy[1] + dy)

        return replace(
            self, nail_xy=there(self.nail_xy), stand_height=self.stand_height + dz,
            nails=tuple(replace(nail, xy=there(nail.xy)) for nail in self.nails),
            block_xy=None if self.block_xy is None else there(self.block_xy),
        )  # fmt: skip

    def X_base_nail(self, protrusion: float | None = None) -> Array:
        """Pose of the nail in `base`.

        Args:
            protrusion: Height of the top of the nail's head over the wood, along its axis [m]; None for
                `nail_protrusion`.

        Returns:
            X_base_nail, (4, 4); the origin is the centre of the head's top, z points along the nail into the wood.
        """
        height = self.nail_protrusion if protrusion is None else protrusion
        head = self.p_base_entry + height * self.nail_axis
        return frame_from_axes(z=-self.nail_axis, x=np.array([1.0, 0.0, 0.0]), p=head) + 0.0  # no -0
