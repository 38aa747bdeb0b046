"""Where the wood beside a nail is felt: on wood, beside every other nail, and towards the handle where that may be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from toolee_robot.station import NailConfig, sim_station
from toolee_robot.tasks.hammering.nail_gauge import ASIDE, EDGE, way_to_bare_wood

WORK = sim_station().work

angles = st.floats(0.0, 2.0 * np.pi)
heights = st.floats(0.0, 0.02)


def _towards(angle: float) -> np.ndarray:
    return np.array([np.cos(angle), np.sin(angle), 0.0])


@given(angles, heights)
def test_a_lone_nails_wood_is_felt_towards_the_handle(angle: float, height: float) -> None:
    np.testing.assert_allclose(way_to_bare_wood(WORK, _towards(angle), height), ASIDE * _towards(angle))


@given(angles, heights, st.sampled_from(["left", "middle", "right"]))
def test_in_a_row_it_is_felt_on_wood_and_beside_the_others(angle: float, height: float, name: str) -> None:
    nails = [NailConfig("left", (0.75, 0.14)), NailConfig("middle", (0.75, 0.10)), NailConfig("right", (0.75, 0.06))]
    row = replace(WORK, block_size=(0.08, 0.14, 0.06)).with_nails(*nails).only(name)
    way = way_to_bare_wood(row, _towards(angle), height)
    place = (row.p_base_entry + way)[:2]
    assert way @ _towards(angle) >= -1e-9, "not away from the handle"
    assert all(np.linalg.norm(place - np.array(nail.xy)) >= ASIDE - 1e-9 for nail in nails)
    assert np.all(np.abs(place - np.array(row.block_center)) <= np.array(row.block_size[:2]) / 2 - EDGE + 1e-9)


def test_a_nail_at_the_edge_is_felt_where_there_is_wood() -> None:
    work = replace(WORK, block_xy=(0.77, 0.10))
    way = way_to_bare_wood(work, np.array([-1.0, 0.0, 0.3]), 0.02)
    assert abs(way[0] + 0.75 - 0.77) <= 0.04 - EDGE
    assert way[0] <= 0.0


def test_where_nails_stand_on_all_sides_it_keeps_farthest_from_them() -> None:
    around = [(0.04 * np.cos(a), 0.04 * np.sin(a)) for a in np.deg2rad([0, 90, 180, 270])]
    nails = [NailConfig(f"{k}", (0.75 + x, 0.10 + y)) for k, (x, y) in enumerate(around)]
    work = replace(WORK, block_size=(0.14, 0.14, 0.06)).with_nails(NailConfig("middle", (0.75, 0.10)), *nails)
    place = way_to_bare_wood(work, np.array([1.0, 0.0, 0.0]), 0.02)[:2]
    assert min(np.linalg.norm(place - np.array(one)) for one in around) > 0.028
