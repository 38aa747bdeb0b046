"""Textures, rooms and backdrops by number; each fifth is held out: the splits share no surroundings."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from toolee_robot.perception.offline.dataset.records import BACKDROPS, ROOMS, TEXTURES, draw
from toolee_robot.render import Material, Pattern
from toolee_robot.render.lab import Surroundings, laboratory
from toolee_robot.render.palette import any_color, finish, linear

_TEXTURE, _ROOM, _BACKDROP = 101, 102, 103
_FINISHES = ("plastic", "wood", "steel_bright", "rubber", "concrete", "skin")
_SCALE = 0.03


@dataclass(frozen=True)
class Surfaces:
    """Surfaces of one split.

    Attributes:
        split: "train" or "test".
    """

    split: str

    def material(self, rng: np.random.Generator, scale: float = _SCALE) -> Material:
        """Draw a texture with a random offset.

        Args:
            rng: Random generator.
            scale: Approximate size of its features [m].

        Returns:
            The material.
        """
        texture = _texture(draw(rng, self.split, TEXTURES))
        x, y, z = (float(v) for v in rng.uniform(-1.0, 1.0, 3))
        return replace(texture, scale=texture.scale * scale / _SCALE, offset=(x, y, z))

    def room(self, rng: np.random.Generator) -> int:
        """Random number of a room; it determines the content of the room (`room_rng`)."""
        return draw(rng, self.split, ROOMS)

    def laboratory(self, rng: np.random.Generator, body_id: int) -> Surroundings:
        """Draw a furnished room.

        Args:
            rng: Random generator.
            body_id: Body id of all of its bodies.

        Returns:
            The room.
        """
        return _laboratory(self.room(rng), body_id)

    def backdrop(self, rng: np.random.Generator) -> np.random.Generator:
        """Random generator of a backdrop, determined by its number."""
        return np.random.default_rng([_BACKDROP, draw(rng, self.split, BACKDROPS)])


def room_rng(room: int) -> np.random.Generator:
    """Random generator of a room, determined by its number."""
    return np.random.default_rng([_ROOM, room])


@lru_cache(maxsize=ROOMS)
def _laboratory(room: int, body_id: int) -> Surroundings:
    return laboratory(room_rng(room), body_id)


@lru_cache(maxsize=TEXTURES)
def _texture(number: int) -> Material:
    """A plain or patterned texture by number."""
    rng = np.random.default_rng([_TEXTURE, number])
    if rng.random() < 0.4:
        name = str(rng.choice(_FINISHES))
        metallic = float(name.startswith("steel"))
        return finish(name, any_color(rng), float(rng.uniform(0.2, 0.9)), metallic, rng, axis=int(rng.integers(3)))
    pattern = list(Pattern)[rng.integers(len(Pattern))]
    return Material(
        linear(any_color(rng)),
        linear(any_color(rng)),
        pattern,
        float(_SCALE * np.exp(rng.normal(0.0, 0.7))),
        int(rng.integers(3)),
        float(rng.uniform(0.15, 0.95)),
        float(rng.random() < 0.12),
        float(rng.uniform(0.0, 0.5)),
    )
