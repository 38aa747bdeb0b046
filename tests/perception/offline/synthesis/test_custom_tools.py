"""A data set of tools that a user brings: from a mesh and a YAML to the evaluation's report."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.examples import examples
from tests.perception.folders import unsound
from toolee_robot.cli.app import run
from toolee_robot.end_effectors import Category
from toolee_robot.errors import ConfigError
from toolee_robot.frames import is_rigid, transform, transform_points
from toolee_robot.perception.offline.dataset.catalogue import CustomTool
from toolee_robot.perception.offline.dataset.instances import read_ply
from toolee_robot.perception.offline.dataset.records import read_json
from toolee_robot.perception.offline.dataset.spec import catalogue_of
from toolee_robot.perception.offline.evaluation.examples import ee_shape
from toolee_robot.perception.offline.synthesis.custom_tool_reader import MOST_FACES, read_custom_tools

pytestmark = pytest.mark.sim(seconds=15)

HANDLE, FACE, LENGTH = 14.0, 18.0, 250.0


def bring(folder: Path, X: np.ndarray | None = None, **change: Any) -> None:
    """A mallet with two faces [mm]: a handle along z from 0, a head along x at its top; all moved by X."""
    X = np.eye(4) if X is None else X
    handle = trimesh.creation.cylinder(HANDLE, segment=np.array([[0, 0, 0], [0, 0, LENGTH]]))
    head = trimesh.creation.cylinder(FACE, segment=np.array([[-50, 0, LENGTH], [60, 0, LENGTH]]))
    folder.mkdir(parents=True)
    mesh: Any = trimesh.util.concatenate([handle, head])
    mesh.apply_transform(X)
    mesh.export(folder / "mallet.stl")

    def point(*p: float) -> list[float]:
        return [float(v) for v in transform_points(X, np.array([p]))[0]]

    def axis(*a: float) -> list[float]:
        return [float(v) for v in X[:3, :3] @ a]

    description = {
        "mesh": "mallet.stl",
        "scale": 0.001,
        "handle": {"butt": point(0, 0, 0), "end": point(0, 0, LENGTH - 20)},
        "ees": [
            {"category": "hammer_head", "position": point(60, 0, LENGTH), "z": axis(2, 0, 0)},
            {"category": "hammer_head", "position": point(-50, 0, LENGTH), "z": axis(-1, 0, 0)},
        ],
        "materials": {"handle": "wood", "head": "rubber"},
    }
    (folder / "tool.yaml").write_text(yaml.safe_dump(description | change))


@pytest.mark.nightly
def test_a_mesh_that_is_damaged_or_too_fine_is_named(tmp_path: Path) -> None:
    bring(tmp_path / "mallet")
    path = tmp_path / "mallet" / "mallet.stl"
    sound: Any = trimesh.load(path)
    config = tmp_path / "mallet" / "tool.yaml"
    config.write_text(config.read_text().replace("mallet.stl", "mallet.off"))
    lines = sound.export(file_type="off").split("\n")
    vertices = int(lines[1].split()[0])
    lines[2 + vertices] = f"3 0 1 {vertices + 7}"
    finer = sound.subdivide().subdivide().subdivide().subdivide().subdivide()
    assert len(finer.faces) > MOST_FACES
    for text, said in (("\n".join(lines), "mallet.off"), (finer.export(file_type="off"), "simplify")):
        config.with_name("mallet.off").write_text(text)
        with pytest.raises(ConfigError) as refused:
            read_custom_tools(tmp_path)
        assert said in str(refused.value)


@pytest.fixture(scope="module")
def tools(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tools")
    bring(folder / "my-mallet")
    bring(folder / "other.mallet", transform(Rotation.from_euler("xyz", [0.3, 1.0, -2.0]), [40.0, -700.0, 9.0]))
    return folder


@pytest.fixture(scope="module")
def made(tools: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("made") / "own"
    options = ["--config", "hard", "--size", "4", "--seed", "5", "--workers", "1", "--tools", str(tools)]
    assert run(["dataset", "generate", *options, "--out", str(out)]) == 0
    return out


def test_the_files_show_the_tools_by_name_and_all_held_out(made: Path) -> None:
    entries = [e for image in read_json(made / "test/000000/scene_gt.json").values() for e in image]
    assert {e["instance"] for e in entries} <= {"my-mallet", "other.mallet"}
    assert entries
    assert not list((made / "train").iterdir())
    models = read_json(made / "models/models_info.json")
    assert {int(obj_id) for obj_id in models} <= {7801, 7802, 7805, 7806}, "the ids of data sets from before"
    for entry in models.values():
        assert entry["split"] == "test"
        assert "symmetries_continuous" in entry
    card = read_json(made / "card.json")
    assert card["catalogue"]["test"]["hammer_head"] == ["my-mallet", "other.mallet"]
    assert card["catalogue"]["train"]["hammer_head"] == []
    assert "my-mallet" in (made / "README.md").read_text()
    assert unsound(made) == set()


def test_the_evaluation_reports_on_them(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--true-masks-only", "--json", "--out", str(tmp_path)]
    assert run(["evaluate", "pose", str(made), *arguments]) == 0
    report = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert report["data"]["targets"] == report["data"]["targets_held_out"] > 0
    assert 1 <= report["data"]["held_out_tools"] <= 2
    groups = report["estimators"]["ours"]["truth"]["groups"]
    assert set(groups) == {"held-out"}
    assert set(groups["held-out"]["table"]) == {"hammer_head", "average"}


@pytest.mark.nightly
def test_another_folder_with_the_same_content_gives_the_same_bytes(tools: Path, made: Path, tmp_path: Path) -> None:
    (tmp_path / "elsewhere").symlink_to(tools)
    options = ["--size", "4", "--seed", "5", "--workers", "2", "--tools", str(tmp_path / "elsewhere")]
    assert run(["dataset", "generate", "--config", "hard", *options, "--out", str(tmp_path / "again")]) == 0
    assert (tmp_path / "again/SHA256SUMS").read_bytes() == (made / "SHA256SUMS").read_bytes()


def test_a_changed_tool_is_another_data_set(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bring(tmp_path / "tools/my-mallet", scale=0.0011)
    options = ["--config", "hard", "--size", "4", "--seed", "5", "--tools", str(tmp_path / "tools")]
    assert run(["dataset", "generate", *options, "--out", str(made)]) == 2
    assert "another data set (other tools)" in capsys.readouterr().err


def test_ones_own_tools_have_no_kinds(tools: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--config", "hard", "--size", "4", "--tools", str(tools), "--kinds", "13"]
    assert run(["dataset", "generate", *options, "--out", str(tmp_path / "own")]) == 2
    assert "give --kinds or --tools, not both" in capsys.readouterr().err
    assert not (tmp_path / "own").exists()


def test_frames_handle_and_parts(made: Path) -> None:
    """Whatever frame the mesh was drawn in, the tool's is the project's."""
    catalogue = catalogue_of(made / "test")
    for number in catalogue.numbers("test"):
        tool = catalogue.tool(number)
        assert isinstance(tool, CustomTool)
        face, other = tool.ees
        # The grip is 80 mm above the butt; x is the working face's normal; an EE's x points to the butt.
        np.testing.assert_allclose(face.X_tool_ee[:3, 3], [0.060, 0.0, LENGTH / 1e3 - 0.08], atol=1e-6)
        np.testing.assert_allclose(face.X_tool_ee[:3, 2], [1, 0, 0], atol=1e-6)
        np.testing.assert_allclose(face.X_tool_ee[:3, 0], [0, 0, -1], atol=1e-6)
        np.testing.assert_allclose(other.X_tool_ee[:3, 3], [-0.050, 0.0, LENGTH / 1e3 - 0.08], atol=1e-6)
        assert (tool.handle.z_min, tool.handle.z_max) == pytest.approx((-0.08, LENGTH / 1e3 - 0.1))
        assert tool.handle.radii_at(0.0) == pytest.approx((HANDLE / 1e3, HANDLE / 1e3), rel=0.03)
        points, normals, parts = tool.sample_surface(4000, np.random.default_rng(0))
        labels = np.array([part.label for part in tool.parts])[parts]
        assert set(labels[points[:, 2] < 0.12]) == {"handle"}
        assert set(labels[np.abs(points[:, 0]) > 0.02]) == {"head"}
        assert [part.material.name for part in tool.parts[:2]] == ["wood", "rubber"]
        assert np.mean(normals[labels == "handle"][:, :2] * points[labels == "handle"][:, :2]) > 0, "outwards"
        shape = ee_shape(catalogue, number, 0)
        assert shape.high[2] == pytest.approx(0.0, abs=1e-6)
        assert 2 * FACE / 1e3 < shape.diameter < 0.1
        vertices, _ = read_ply(made / f"tools/{tool.name}.ply")
        assert np.ptp(vertices, axis=0) == pytest.approx([110.0, 2 * FACE, LENGTH + FACE], rel=0.01)


def test_a_claw_is_told_from_handle_and_head(tmp_path: Path) -> None:
    """What is behind the handle, near the grip's origin: it tells the spin about a hammer's axis."""
    grip = {"category": "hammer_grip", "position": [-40, 0, LENGTH], "z": [0, 0, 1], "x": [-1, 0, 0]}
    face = {"category": "hammer_head", "position": [60, 0, LENGTH], "z": [1, 0, 0]}
    bring(tmp_path / "claw", ees=[face, grip])
    (brought,) = read_custom_tools(tmp_path)
    assert brought.record.categories == (Category.HAMMER_HEAD, Category.HAMMER_GRIP)
    (tmp_path / "tool.ply").write_bytes(brought.ply)
    vertices, faces = read_ply(tmp_path / "tool.ply")
    tool = CustomTool.build(brought.record, 0, 1e-3 * vertices, faces)
    points, _, parts = tool.sample_surface(6000, np.random.default_rng(0))
    labels = np.array([part.label for part in tool.parts])[parts]
    assert points[labels == "claw"][:, 0].max() < -0.01
    assert np.mean(labels[(points[:, 0] < -0.045)] == "claw") > 0.9
    assert "claw" not in labels[points[:, 0] > 0.01]


@examples(25)
@given(st.tuples(*[st.floats(-3, 3)] * 3), st.sampled_from([0.001, 0.01, 0.0254, 1.0]))
def test_any_frame_and_unit_give_the_same_tool(
    tmp_path_factory: pytest.TempPathFactory, turn: tuple[float, float, float], unit: float
) -> None:
    folder = tmp_path_factory.mktemp("turned")
    X = transform(Rotation.from_rotvec(turn), [3.0, -500.0, 20.0])
    X[:3] *= 0.001 / unit
    bring(folder / "mallet", X, scale=unit)
    record = read_custom_tools(folder)[0].record
    for X_tool_ee, x in zip(record.Xs_tool_ee, (0.060, -0.050), strict=True):
        assert is_rigid(np.reshape(X_tool_ee, (4, 4)), 1e-5)
        np.testing.assert_allclose(np.reshape(X_tool_ee, (4, 4))[:3, 3], [x, 0, LENGTH / 1e3 - 0.08], atol=1e-4)


def test_the_example_in_the_documentation_is_read(tmp_path: Path) -> None:
    text = (Path(__file__).parents[4] / "docs/dataset.md").read_text()
    bars = ([[0, -240, 0], [0, 10, 0]], [[0, 5, -60], [0, 5, 62]])
    mesh: Any = trimesh.util.concatenate([trimesh.creation.cylinder(14.0, segment=np.array(bar)) for bar in bars])
    (tmp_path / "hammer").mkdir()
    mesh.export(tmp_path / "hammer/hammer.stl")
    (tmp_path / "hammer/tool.yaml").write_text(text.split("```yaml\n")[1].split("```")[0])
    (brought,) = read_custom_tools(tmp_path)
    assert brought.record.categories == (Category.HAMMER_HEAD, Category.HAMMER_GRIP)
    assert brought.record.handle_material == "rubber"


def ee(**change: Any) -> dict[str, Any]:
    return {"ees": [{"category": "hammer_head", "position": [60, 0, LENGTH], "z": [1, 0, 0]} | change]}


@pytest.mark.parametrize(
    ("change", "expected_text"),
    [
        ({"scale": 1}, "with scale 1 the tool is 269 m long; scale: 0.001 would make it 0.27 m"),
        ({"scale": -1}, "scale: Input should be greater than 0"),
        ({"ees": []}, "ees: Tuple should have at least 1 item"),
        ({"mass": 0.3}, "mass: there is no such field"),
        ({"mesh": "none.stl"}, "cannot read the mesh"),
        ({"mesh": "tool.yaml"}, "cannot read the mesh"),
        (ee(category="spoon"), "ees.0.category: Input should be 'hammer_head'"),
        (ee(position=[0.06, 0, 0.25]), "reaches 14 mm beyond position along z"),
        (ee(position=[60, 0, 900]), "0.6.* m off the surface"),
        (ee(z=[-1, 0, 0]), "reaches 110 mm beyond position along z; z points out of it"),
        (ee(z=[0, 0, 0]), "an axis is zero"),
        (ee(x=[1, 0, 1]), "x and z are 45 deg apart"),
        (ee(category="hammer_grip"), "needs x"),
        ({"handle": {"butt": [0, 0, 0], "end": [0, 0, 0.23]}}, "butt and end are 0.00023 m apart"),
        ({"handle": {"butt": [90, 0, 0], "end": [90, 0, 230]}}, "no surface is within 35 mm"),
        ({"materials": {"handle": "cheese"}}, "materials.handle: .*choose one of steel_bright"),
    ],
)
def test_a_wrong_description_says_what_to_change(tmp_path: Path, change: dict[str, Any], expected_text: str) -> None:
    bring(tmp_path / "tool", **change)
    with pytest.raises(ConfigError, match=expected_text):
        read_custom_tools(tmp_path)


def empty(folder: Path) -> None:
    folder.mkdir()


def without_description(folder: Path) -> None:
    (folder / "hammer").mkdir(parents=True)


def odd_name(folder: Path) -> None:
    bring(folder / "my hammer")


def a_cloud(folder: Path) -> None:
    bring(folder / "cloud", mesh="cloud.ply")
    cloud: Any = trimesh.PointCloud
    cloud(np.random.default_rng(0).random((9, 3))).export(folder / "cloud/cloud.ply")


@pytest.mark.parametrize(
    ("make", "expected_text"),
    [
        (lambda _: None, "there is no such folder"),
        (empty, "holds no folders"),
        (without_description, "tool.yaml"),
        (odd_name, "letters, digits"),
        (a_cloud, "no triangles"),
    ],
)
def test_a_wrong_folder_says_what_to_change(tmp_path: Path, make: Callable[[Path], None], expected_text: str) -> None:
    make(tmp_path / "tools")
    with pytest.raises(ConfigError, match=expected_text):
        read_custom_tools(tmp_path / "tools")


def test_custom_tools_cannot_be_trained_on(tools: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--config", "hard", "--test-share", "0.5", "--size", "4", "--tools", str(tools)]
    assert run(["dataset", "generate", *options, "--out", str(tmp_path / "out")]) == 2
    assert "all held out" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
