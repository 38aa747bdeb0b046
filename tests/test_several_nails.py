"""A station file with several nails: read, completed, refused where it cannot be; one with a single nail as ever."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from tests.errors import raises
from toolee_robot.control.collision_shapes import nail_bodies
from toolee_robot.errors import ConfigError
from toolee_robot.station import NailConfig, StationConfig, load_station, sim_station

BLOCK = [0.08, 0.14, 0.06]
LEFT = {"name": "left", "xy": [0.75, 0.14]}
RIGHT = {"name": "right", "xy": [0.75, 0.06], "protrusion": 0.015}


def _load(folder: Path, work: dict[str, object], frame: str = "base_link") -> StationConfig:
    path = folder / "station.yaml"
    path.write_text(yaml.safe_dump({"frame": frame, "work": {"block_size": BLOCK, **work}}))
    return load_station(path)


def test_several_nails_have_sizes_of_their_own_or_those_of_all(tmp_path: Path) -> None:
    work = _load(tmp_path, {"nails": [LEFT, RIGHT], "nail_protrusion": 0.018}).work
    assert work.names == ("left", "right")
    assert work.block_center == pytest.approx((0.75, 0.10))
    heights = {name: one.nail_protrusion for name, one in work.each()}
    assert heights == {"left": 0.018, "right": 0.015}
    X = work.only("right").X_base_nail()
    np.testing.assert_allclose(X[:3, 3], [0.75, 0.06, work.wood_height + 0.015])
    assert [body.name for body in nail_bodies(work, ["left"])] == ["nail left"]


def test_one_nail_is_written_as_ever(tmp_path: Path) -> None:
    work = _load(tmp_path, {"nail_xy": [0.7, 0.05]}).work
    assert work.names == ("nail",)
    assert work.only("nail") == work
    assert work.block_center == work.nail_xy == (0.7, 0.05)


def test_the_pendants_frame_holds_for_every_nail(tmp_path: Path) -> None:
    nails = [{**nail, "xy": [-nail["xy"][0], -nail["xy"][1]]} for nail in (LEFT, RIGHT)]  # type: ignore[index]
    turned = _load(tmp_path, {"nails": nails, "block_xy": [-0.75, -0.10]}, "pendant_base")
    assert turned == _load(tmp_path, {"nails": [LEFT, RIGHT], "block_xy": [0.75, 0.10]})


@pytest.mark.parametrize(
    "work",
    [
        {"nails": [LEFT, {**LEFT, "xy": [0.75, 0.06]}]},  # two of one name
        {"nails": [LEFT, {"name": "near", "xy": [0.75, 0.12]}]},  # the hammer would meet both
        {"nails": [LEFT, RIGHT], "nail_xy": [0.70, 0.10]},  # of no nail
        {"nails": [LEFT, RIGHT], "block_xy": [0.75, 0.30]},  # beside the wood
        {"nails": [LEFT, {**RIGHT, "protrusion": 0.05}]},  # longer than it is
        {"nails": [{"name": "with space", "xy": [0.75, 0.1]}]},
    ],
)
def test_what_cannot_be_is_refused(tmp_path: Path, work: dict[str, object]) -> None:
    with pytest.raises(ConfigError):
        _load(tmp_path, work)


def test_nails_without_a_frame_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "station.yaml"
    path.write_text(yaml.safe_dump({"work": {"block_size": BLOCK, "nails": [LEFT, RIGHT]}}))
    with raises(ConfigError, code="config.no_frame") as refused:
        load_station(path)
    assert "gives work.nails, but" in str(refused.value)


def test_the_wood_moves_with_its_nails() -> None:
    work = sim_station().work
    work = work.with_nails(NailConfig("a", (0.74, 0.10)), NailConfig("b", (0.78, 0.10)))
    moved = work.moved(0.01, -0.02, 0.003)
    for name in work.names:
        way = moved.only(name).X_base_nail()[:3, 3] - work.only(name).X_base_nail()[:3, 3]
        np.testing.assert_allclose(way, [0.01, -0.02, 0.003], atol=1e-12)
    assert np.subtract(moved.block_center, work.block_center) == pytest.approx((0.01, -0.02))
