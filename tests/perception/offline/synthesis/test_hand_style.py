"""Colours of hands: skin of all tones and no other, gloves of many."""

from __future__ import annotations

import numpy as np

from toolee_robot.perception.offline.synthesis.bodies import HandStyle
from toolee_robot.render.material import any_glove_color, any_skin_tone


def test_skin_covers_the_monk_scale_and_stays_skin() -> None:
    rng = np.random.default_rng(0)
    tones = np.array([any_skin_tone(rng) for _ in range(2000)])
    assert tones.min() >= 0.0
    assert tones.max() <= 1.0
    bright = tones.mean(axis=1)
    assert np.quantile(bright, 0.05) < 0.2
    assert np.quantile(bright, 0.95) > 0.83
    red, green, blue = tones.T
    assert np.mean((red >= green - 0.03) & (green >= blue - 0.06)) > 0.95, "neither blue nor green"


def test_gloves_and_hands_have_many_colours() -> None:
    rng = np.random.default_rng(1)
    gloves = np.array([any_glove_color(rng) for _ in range(500)])
    assert np.all(gloves.std(axis=0) > 0.2)
    styles = [HandStyle.varied(rng) for _ in range(300)]
    assert 0.3 < np.mean([style.mirrored for style in styles]) < 0.5
    bare = np.mean([style.palm is style.sleeve for style in styles])
    assert 0.1 < bare < 0.35, "hands with bare forearms"
    assert len({style.palm.color for style in styles}) > 150
