"""A nut on a bolt, and the jaw of an open-ended wrench that turns it. Angles are positive in the tightening direction.

The nut turns freely against the friction of its thread, then it is seated: the torque rises linearly with its angle, by
the stiffness of the joint. It turns only while something turns it with more than that torque; backwards it needs a
share of it. Nothing else moves it.

An M8 nut of class 8 on a bolt of class 8.8 is tightened to about 25 Nm (VDI 2230-1, table A1, at a coefficient of
friction of 0.12). A hand that holds a wrench by a grip 0.12 m from the jaw would have to bear 200 N for that. The joint
here is soft: a spring washer or a gasket, which is closed at 4 Nm, some 2.5 kN by T = 0.2 F d. Its stiffness and the
friction of the thread are assumed.

The sizes: nut of ISO 4032 (M8: 12.73 to 13.00 mm across flats, at least 6.44 mm high), jaw of ISO 691 and DIN 475 for
13 mm (13.04 to 13.24 mm). The shape of the jaw is simplified: two parallel flats of one length with a throat that the
nut's corner fits into.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

SIXTH = math.pi / 3
"""Angle after which a hexagon looks the same [rad]."""
LEAST_OVERLAP = 0.0015
"""Height of the nut that the jaw must cover to hold it [m]; assumed."""
LARGEST_TILT = math.radians(8.0)
"""Tilt of the jaw against the nut's axis beyond which it does not go on, or comes off under load [rad]; assumed."""
LEAST_COVER = 0.5
"""Share of a flat that must lie in the jaw, or it slips off under load; assumed."""
SLIPPING_TORQUE = 0.3
"""Torque beyond which a jaw that is not well on the nut slips off [Nm]; assumed."""


@dataclass(frozen=True)
class NutSpec:
    """A nut and its joint.

    Attributes:
        across_flats: Width between two flats [m].
        height: Height of the nut [m].
        friction: Torque of the thread before the nut is seated [Nm].
        run: Angle that it turns until it is seated [rad].
        stiffness: Rise of the torque with the angle from there on [Nm/rad].
        loosening: Torque that turns it back, as a share of the one that tightens it.
    """

    across_flats: float = 0.0129
    height: float = 0.0065
    friction: float = 0.15
    run: float = 1.5
    stiffness: float = 3.0
    loosening: float = 0.8

    @property
    def flat(self) -> float:
        """Length of a flat along the jaw [m]; also the distance of a corner from the axis."""
        return self.across_flats / math.sqrt(3.0)

    @classmethod
    def draw(cls, rng: np.random.Generator) -> NutSpec:
        """Draw a nut within its tolerances, and a joint."""
        size, run, stiffness = rng.uniform(0.01273, 0.01300), rng.uniform(0.8, 2.0), rng.uniform(2.5, 4.0)
        return cls(float(size), friction=float(rng.uniform(0.05, 0.25)), run=float(run), stiffness=float(stiffness))


@dataclass
class Nut:
    """A nut that is turned.

    Attributes:
        spec: Nut and joint.
        angle: How far it has turned [rad].
        largest: Largest torque so far with which it was turned [Nm].
    """

    spec: NutSpec = field(default_factory=NutSpec)
    angle: float = 0.0
    largest: float = 0.0

    @property
    def torque(self) -> float:
        """Torque that turns it on from here [Nm]."""
        return self.spec.friction + self.spec.stiffness * max(self.angle - self.spec.run, 0.0)

    def follow(self, jaw: float, play: float, stiffness: float) -> float:
        """Let a jaw be at an angle: the nut turns as far as the jaw turns it.

        Args:
            jaw: Angle of the jaw, 0 where it is square to the nut at angle 0 [rad].
            play: How far the jaw turns to each side of the nut's angle before it meets its corners [rad].
            stiffness: Stiffness of the jaw against the nut beyond that [Nm/rad].

        Returns:
            Torque of the nut on the jaw [Nm]: negative where the jaw tightens.
        """
        ahead = jaw - self.angle
        if ahead > play:
            if stiffness * (ahead - play) > self.torque:
                self._tighten(jaw - play, stiffness)
            torque = stiffness * max(jaw - self.angle - play, 0.0)
            self.largest = max(self.largest, torque)
            return -torque
        if ahead < -play:
            if stiffness * (-ahead - play) > self.spec.loosening * self.torque:
                self._loosen(jaw + play, stiffness)
            return stiffness * max(self.angle - jaw - play, 0.0)
        return 0.0

    def _tighten(self, driven: float, stiffness: float) -> None:
        """Turn until the jaw's torque, whose corners are at an angle, is the nut's."""
        spec = self.spec
        free = driven - spec.friction / stiffness
        if free > spec.run:
            free = (stiffness * driven - spec.friction + spec.stiffness * spec.run) / (stiffness + spec.stiffness)
        self.angle = max(self.angle, free)

    def _loosen(self, driven: float, stiffness: float) -> None:
        spec = self.spec
        share = spec.loosening
        free = driven + share * spec.friction / stiffness
        if free > spec.run:
            seated = share * (spec.friction - spec.stiffness * spec.run)
            free = max((stiffness * driven + seated) / (stiffness - share * spec.stiffness), spec.run)
        self.angle = min(self.angle, free)


class Fit(StrEnum):
    """How a jaw stands to a nut.

    Attributes:
        APART: It is away from it, or above or below it.
        BLOCKED: It stands before it, and does not go on.
        ENTERING: The nut is between the tips of the flats.
        ON: The nut is in the jaw.
    """

    APART = "apart"
    BLOCKED = "blocked"
    ENTERING = "entering"
    ON = "on"


@dataclass(frozen=True)
class JawPlace:
    """Where the nut is in the jaw.

    Attributes:
        along: Nut's axis from the middle of the flats, towards the mouth [m].
        beside: Nut's axis beside the middle of the slot [m].
        above: Middle of the jaw over the middle of the nut [m].
        tilt: Angle between the axes of jaw and nut [rad].
    """

    along: float
    beside: float
    above: float
    tilt: float


@dataclass(frozen=True)
class Jaw:
    """The jaw of an open-ended wrench.

    Attributes:
        opening: Width between the flats [m].
        half_length: Half the length of the flats [m].
        half_thickness: Half the thickness [m].
    """

    opening: float = 0.01314
    half_length: float = 0.0068
    half_thickness: float = 0.0025

    def depth(self, nut: NutSpec, along: float) -> float:
        """How far the nut's foremost corner is within the mouth [m]."""
        return self.half_length - along + nut.flat

    def room(self, nut: NutSpec, along: float) -> float:
        """How far the nut may be beside the middle of the slot [m]: the more, the less of it is in the mouth."""
        return 0.5 * self.opening - min(0.5 * nut.across_flats, math.sqrt(3.0) * max(self.depth(nut, along), 0.0))

    def play(self, nut: NutSpec, along: float) -> float:
        """How far jaw and nut may be turned against each other to each side [rad]."""
        fitting = (self.opening - nut.across_flats) / nut.flat
        entered = min(max(self.depth(nut, along) / nut.flat, 0.0), 1.0)
        return fitting + (0.5 * SIXTH - fitting) * (1.0 - entered) ** 2

    def cover(self, nut: NutSpec, along: float) -> float:
        """Share of the nut's flats that lie in the jaw."""
        return min(max((self.half_length - along + 0.5 * nut.flat) / nut.flat, 0.0), 1.0)

    def level(self, nut: NutSpec, above: float) -> bool:
        """Whether the jaw is at the height of the nut."""
        covered = min(above + self.half_thickness, 0.5 * nut.height) - max(
            above - self.half_thickness, -0.5 * nut.height
        )
        return covered >= LEAST_OVERLAP

    def fit(self, nut: NutSpec, place: JawPlace, before: Fit, turned: float) -> Fit:
        """How the jaw stands to the nut.

        Args:
            nut: The nut.
            place: Where the nut is in the jaw.
            before: How it stood a moment ago: a nut comes in through the mouth.
            turned: Angle of the jaw against the nearest flats [rad].

        Returns:
            How it stands now.
        """
        depth = self.depth(nut, place.along)
        beside = abs(place.beside) > 0.5 * self.opening + nut.flat
        if depth <= 0.0 or not self.level(nut, place.above) or beside or depth > 6.0 * nut.flat:
            return Fit.APART
        if before is Fit.APART:
            fits = depth < 0.5 * nut.flat and abs(place.beside) < 0.5 * self.opening and place.tilt < LARGEST_TILT
            before = Fit.ENTERING if fits and abs(turned) < self.play(nut, place.along) else Fit.BLOCKED
        if before is Fit.BLOCKED:
            return Fit.BLOCKED
        return Fit.ON if self.cover(nut, place.along) >= LEAST_COVER else Fit.ENTERING

    def slips(self, nut: NutSpec, place: JawPlace, torque: float) -> bool:
        """Whether the jaw comes off under a torque [Nm]."""
        held = self.cover(nut, place.along) >= LEAST_COVER and place.tilt <= LARGEST_TILT
        return abs(torque) > SLIPPING_TORQUE and not held
