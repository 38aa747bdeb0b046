"""Textures, rooms and backdrops by number, every fifth of them held out: what surrounds the tools in the test split
never surrounds them in training."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from toolee_robot.perception.dataset.holdout import BACKDROPS, ROOMS, TEXTURES, draw
from toolee_robot.render import Material, Pattern
from toolee_robot.render.lab import Surroundings, laboratory
from toolee_robot.render.palette import any_color, finish, linear

_TEXTURE, _ROOM, _BACKDROP = 101, 102, 103
_FINISHES = ("plastic", "wood", "steel_bright", "rubber", "concrete", "skin")
_SCALE = 0.03


@dataclass(frozen=True)
class Surfaces:
    """The surfaces of one split, "train" or "test"."""

    split: str

    def material(self, rng: np.random.Generator, scale: float = _SCALE) -> Material:
        """A texture, its pattern's features about `scale` [m] large, placed anywhere."""
        texture = _texture(draw(rng, self.split, TEXTURES))
        x, y, z = (float(v) for v in rng.uniform(-1.0, 1.0, 3))
        return replace(texture, scale=texture.scale * scale / _SCALE, offset=(x, y, z))

    def room(self, rng: np.random.Generator) -> int:
        """A room's number, on which alone depends what is in it: see `room_rng`."""
        return draw(rng, self.split, ROOMS)

    def laboratory(self, rng: np.random.Generator, body_id: int) -> Surroundings:
        """A furnished room."""
        return _laboratory(self.room(rng), body_id)

    def backdrop(self, rng: np.random.Generator) -> np.random.Generator:
        """The generator of a flat backdrop, likewise."""
        return np.random.default_rng([_BACKDROP, draw(rng, self.split, BACKDROPS)])


def room_rng(room: int) -> np.random.Generator:
    """What a room is made with."""
    return np.random.default_rng([_ROOM, room])


@lru_cache(maxsize=ROOMS)
def _laboratory(room: int, body_id: int) -> Surroundings:
    return laboratory(room_rng(room), body_id)


@lru_cache(maxsize=TEXTURES)
def _texture(number: int) -> Material:
    """Any plain or patterned surface."""
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
