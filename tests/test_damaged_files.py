"""What a damaged or foreign file does: an error that names it, or the right value; soon, and in little memory."""

from __future__ import annotations

import json
import os
import resource
import struct
import subprocess
import sys
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, seed
from hypothesis import strategies as st

from tests.errors import raises
from tests.examples import examples
from tests.perception.offline.synthesis.test_custom_tools import bring
from tests.recording import small_run
from toolee_robot.calibration.record import FORMAT, read_record, write_signed
from toolee_robot.calibration.session import read_image as read_board_image
from toolee_robot.errors import AssetError, ConfigError, TooleeError, UserError
from toolee_robot.perception.io import bop_images, parse_intrinsics, read_depth, read_pose, read_rgb
from toolee_robot.perception.offline.annotation.clicks import ClicksFile, read_clicks, write_clicks
from toolee_robot.perception.offline.synthesis.custom_tool_reader import read_custom_tools
from toolee_robot.perception.weight_files import load_weights, save_weights
from toolee_robot.recording.reading import read_history
from toolee_robot.runtime.files import claimed, from_json, read_text, run_folder
from toolee_robot.station import load_station, sim_station
from toolee_robot.trials import TrialPlan, load_plan
from toolee_robot.trials.results import RESULTS, Happened, Results, read_results

EXAMPLES = Path(__file__).parents[1] / "examples"
PLAN = TrialPlan("a plan", 1, 2)
LONGEST = 5.0
"""Processor time that a reader may take of a damaged file [s]."""

_BOMB = "a0: &a0 [x, x]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 8)}]\n" for i in range(1, 14))
YAMLS: dict[str, str | bytes] = {
    "no such day": "robot: {host: 2026-02-30}",
    "a number of 5,000 digits": f"strike: {{touch_force: {'9' * 5000}}}",
    "no whole number": "robot: {host: !!int abc}",
    "no truth value": "robot: {host: !!bool abc}",
    "no time": "robot: {host: !!timestamp abc}",
    "5,000 brackets": f"hand: {'[' * 5000}{']' * 5000}",
    "an alias bomb in a number": f"{_BOMB}strike: {{touch_force: *a13}}",
    "an alias bomb in a text": f"{_BOMB}hand: {{model: *a13}}",
    "itself": "strike: &a {touch_force: *a}",
    "Latin-1": "hand: {model: hämmer}".encode("latin-1"),
    "UTF-16": "hand: {model: hammer}".encode("utf-16"),
    "zeros": bytes(100),
}


@pytest.mark.parametrize("name", YAMLS)
@pytest.mark.parametrize("read", [load_station, load_plan])
def test_a_yaml_file_that_cannot_be_is_named(name: str, read: Callable[[Path], Any], tmp_path: Path) -> None:
    path, data = tmp_path / "lab.yaml", YAMLS[name]
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    began = time.process_time()
    with pytest.raises(ConfigError) as refused:
        read(path)
    assert time.process_time() - began < LONGEST
    assert str(path) in str(refused.value)
    assert len(str(refused.value)) < 5000


@pytest.mark.parametrize("numbers", ["first_seed: 1\ntrials: 1000000000", "first_seed: 2147483000\ntrials: 1000"])
def test_a_plan_without_end_is_refused(numbers: str, tmp_path: Path) -> None:
    path = tmp_path / "plan.yaml"
    path.write_text(f"name: a\n{numbers}\n")
    with raises(ConfigError) as refused:
        load_plan(path)
    assert "trials" in str(refused.value)


def test_a_device_is_no_file_and_an_endless_one_is_not_read() -> None:
    with raises(ConfigError) as refused:
        load_station(Path("/dev/zero"))
    assert "no file" in str(refused.value)


def test_text_is_read_whatever_the_locale(tmp_path: Path) -> None:
    path = tmp_path / "plan.yaml"
    path.write_bytes(b"\xef\xbb\xbf" + "name: Hämmer\r\n".encode())
    program = (
        "import sys; from pathlib import Path; from toolee_robot.runtime.files import read_text\n"
        "print(ascii(read_text(Path(sys.argv[1]))))"
    )
    told = subprocess.run([sys.executable, "-c", program, path], env={**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0"},
                          capture_output=True, text=True, check=True)  # fmt: skip
    assert told.stdout.strip() == r"'name: H\xe4mmer\n'"
    assert read_text(path) == "name: Hämmer\n"


@pytest.mark.parametrize("text", ["NaN", "[-Infinity]", "[" * 100_000, "9" * 5000, "", "{", '{"a": 1}}'])
def test_json_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"\w"):
        from_json(text)


# -- images and arrays ------------------------------------------------------------------------------------------------


def test_an_image_too_large_for_the_memory_is_not_decoded(tmp_path: Path) -> None:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows = zlib.compress(bytes(40_001 * 100))
    head = struct.pack(">IIBBBBB", 20_000, 20_000, 16, 0, 0, 0, 0)
    path = tmp_path / "large.png"
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b""))
    for read, code in (
        (read_rgb, "user.file_unreadable"),
        (read_depth, "user.file_unreadable"),
        (lambda path: read_board_image(path, sim_station().camera.intrinsics), "user"),
    ):
        with raises(UserError, code=code) as refused:
            read(path)
        assert "pixels" in str(refused.value)


def test_an_array_is_not_longer_than_its_file(tmp_path: Path) -> None:
    path = tmp_path / "depth.npy"
    np.save(path, np.ones((4, 4)))
    sound = path.read_bytes()
    longer = sound.replace(b"(4, 4)", b"(999999, 999999)").replace(b" " * 10, b"", 1)
    for data in (longer, sound[:20], sound[:-1], sound[:70], b"", b"\x93NUMPY"):
        path.write_bytes(data)
        for read in (read_depth, read_pose):
            with pytest.raises(UserError) as refused:
                read(path)
            assert str(path) in str(refused.value)


@pytest.mark.parametrize("damage", ["a flipped bit", "zeros", "cut", "NaN"])
def test_damaged_weights_are_not_loaded(damage: str, tmp_path: Path) -> None:
    save_weights(tmp_path, "other", {"w": torch.ones(3)}, {})
    save_weights(tmp_path, "toy", {"w": torch.arange(64.0)}, {"model": "toy"})
    load_weights(tmp_path, "toy")
    shard = tmp_path / "toy-00001-of-00001.safetensors"
    data = shard.read_bytes()
    match damage:
        case "a flipped bit":
            shard.write_bytes(data[:-9] + bytes([data[-9] ^ 8]) + data[-8:])
        case "zeros":
            shard.write_bytes(data[:-128] + bytes(128))
        case "cut":
            shard.write_bytes(data[:-1])
        case "NaN":
            (tmp_path / "sha256.txt").unlink()
            shard.write_bytes(data[:-2] + np.float16(np.nan).tobytes())
    with pytest.raises(AssetError) as refused:
        load_weights(tmp_path, "toy")
    assert "toy" in str(refused.value)
    load_weights(tmp_path, "other")


# -- camera matrices --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("text", ["500,500,64,48", "500,5,32,24", "500,1e9,32,24", "1e9,1e9,32,24", "500,500,32,1"])
def test_intrinsics_of_no_camera_are_refused(text: str) -> None:
    with raises(UserError, code="user.intrinsics"):
        parse_intrinsics(text, 64, 48)


@pytest.mark.parametrize(
    "entry",
    [
        {"cam_K": [365, 0, 0, 0, 366, 0, 16, 12, 1]},  # by columns
        {"cam_K": [365, 0, 16, 0, 366, 12, 0, 0, 2]},
        {"cam_K": [365, 0, 16, 0, 366, 12, 0, 0, 1], "depth_scale": 0},
        {"cam_K": [365, 0, 16, 0, 366, 12, 0, 0, 1], "depth_scale": "NaN"},
    ],
)
def test_a_scenes_matrix_is_a_camera_matrix_by_rows_and_its_depth_has_a_scale(
    entry: dict[str, Any], tmp_path: Path
) -> None:
    for kind in ("rgb", "depth"):
        (tmp_path / kind).mkdir()
        cv2.imwrite(str(tmp_path / kind / "000000.png"), np.full((24, 32), 9000, np.uint16))
    (tmp_path / "scene_camera.json").write_text(json.dumps({"0": entry}))
    with raises(UserError, code="user.bop_camera") as refused:
        bop_images(tmp_path)
    assert "cam_K" in str(refused.value) or "depth_scale" in str(refused.value)
    assert "--" not in str(refused.value), "no option of a single frame"


SIGNED: dict[str, Any] = {
    "format": FORMAT, "measured_at": "2026-11-20T10:00:00", "software": "0.1", "robot_model": "UR10",
    "robot_serial": "1", "kinematics": None, "camera_serial": "1",
    "intrinsics": {"fx": 615.0, "fy": 615.0, "cx": 320.0, "cy": 240.0, "width": 640, "height": 480},
    "board": {"columns": 8, "rows": 5, "square": 0.03}, "bars": None, "X_base_camera": np.eye(4).tolist(),
    "X_flange_board": np.eye(4).tolist(), "covariance": np.eye(6).tolist(), "freedom": 9.0, "pixel_noise": 0.1,
    "arm_noise": [1e-4, 1e-4], "residual": 1e-3, "largest_shift": 1e-3, "target": [0.0, 0.0, 0.95],
    "target_radius": 1e-3, "methods": {}, "rotations": [1.0, 1.0], "board_scale": [1.0, 1e-3], "poses": [],
}  # fmt: skip


def test_clicks_that_could_not_be_read_again_are_not_written(tmp_path: Path) -> None:
    path = tmp_path / "clicks.yaml"
    write_clicks(path, ClicksFile("a lab", tape_offset_mm=4.2))
    before = path.read_bytes()
    with raises(ConfigError):
        write_clicks(path, ClicksFile("a lab", tape_offset_mm=float("inf")))
    assert path.read_bytes() == before
    assert read_clicks(path).tape_offset_mm == 4.2


# -- what other work has left -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text", ["a text that somebody keeps here", "a line\nand another", '{"hash": 1}\n', "[]\n", '"x"\n']
)
def test_a_file_that_is_none_of_trials_is_not_touched(text: str, tmp_path: Path) -> None:
    (tmp_path / RESULTS).write_text(text)
    with pytest.raises(UserError), Results(PLAN, tmp_path):
        pass
    assert (tmp_path / RESULTS).read_text() == text


def test_another_plans_unfinished_line_is_not_cut(tmp_path: Path) -> None:
    with Results(PLAN, tmp_path) as results:
        results.note(Happened.SESSION)
    path = tmp_path / RESULTS
    path.write_text(path.read_text() + '{"unfinished')
    before = path.read_text()
    with raises(UserError, says="other plan"), Results(TrialPlan("another", 1, 2), tmp_path):
        pass
    assert path.read_text() == before
    with Results(PLAN, tmp_path) as results:
        assert len(results.events) == 1
    assert path.read_text() == before.removesuffix('{"unfinished')
    assert len(read_results(PLAN, tmp_path)[1]) == 1


def test_two_cannot_run_trials_in_one_folder_and_a_killed_one_claims_nothing(tmp_path: Path) -> None:
    program = (
        "import sys, time\nfrom pathlib import Path\nfrom toolee_robot.runtime.files import claimed\n"
        "with claimed(Path(sys.argv[1])):\n    print('claimed', flush=True)\n    time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", program, tmp_path], stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "claimed\n"
        with raises(UserError, says="wait for it, or choose another") as refused, Results(PLAN, tmp_path):
            pass
        assert f"process {other.pid}" in str(refused.value)
        assert not (tmp_path / RESULTS).exists()
        other.kill()
    with claimed(tmp_path), raises(UserError, says="wait for it, or choose another"), Results(PLAN, tmp_path):
        pass
    with Results(PLAN, tmp_path):
        pass


def test_jobs_that_begin_in_the_same_second_have_a_folder_each(tmp_path: Path) -> None:
    with (
        run_folder(tmp_path, "seed1") as one,
        run_folder(tmp_path, "seed1") as two,
        run_folder(tmp_path, "seed1") as three,
    ):
        kept = {folder.keep() for folder in (two, one, three)}
    assert len(kept) == 3
    assert set(tmp_path.iterdir()) == kept


# -- mutations --------------------------------------------------------------------------------------------------------


def _recorded(path: Path) -> object:
    """What a recording says; None if it says that it is damaged."""
    said = read_history(path)
    return (said.metadata, said.attachments, [q.tolist() for _, q in said.joints]) if said.complete else None


def _tensors(path: Path) -> object:
    return {name: tensor.tolist() for name, tensor in load_weights(path.parent, "toy")[0].items()}


READERS: dict[str, Callable[[Path], Any]] = {
    "lab.yaml": load_station,
    "plan.yaml": load_plan,
    "clicks.yaml": read_clicks,
    "tools/mallet/tool.yaml": lambda path: read_custom_tools(path.parents[1]),
    "tools/mallet/mallet.stl": lambda path: read_custom_tools(path.parents[1]),
    "pose.json": read_pose,
    "pose.txt": read_pose,
    "pose.npy": read_pose,
    "rgb.png": read_rgb,
    "rgb.jpg": read_rgb,
    "depth.tiff": lambda path: read_depth(path, 0.001),
    "depth.npy": lambda path: read_depth(path, 0.001),
    "scene/scene_camera.json": lambda path: [image.read() for image in bop_images(path.parent)],
    RESULTS: lambda path: read_results(PLAN, path.parent),
}
CHECKSUMMED: dict[str, Callable[[Path], Any]] = {
    "signed.json": read_record,
    "run.mcap": _recorded,
    "weights/toy-00001-of-00001.safetensors": _tensors,
    "weights/sha256.txt": _tensors,
}
"""Readers of what has a checksum: a mutation is refused, told, or changes no value."""


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one sound file of each kind."""
    folder = tmp_path_factory.mktemp("sound")
    (folder / "lab.yaml").write_bytes((EXAMPLES / "lab.yaml").read_bytes())
    (folder / "plan.yaml").write_text("name: a plan\nfirst_seed: 1\ntrials: 2\narms: [full]\n")
    write_clicks(folder / "clicks.yaml", ClicksFile("a lab", tape_offset_mm=4.2))
    bring(folder / "tools" / "mallet")
    write_signed(folder / "signed.json", SIGNED)
    small_run.write(folder / "run.mcap")
    (folder / "weights").mkdir()
    save_weights(folder / "weights", "toy", {"w": torch.arange(64.0)}, {"model": "toy"})
    X = np.eye(4)
    (folder / "pose.json").write_text(json.dumps(X.tolist()))
    np.savetxt(folder / "pose.txt", X)
    np.save(folder / "pose.npy", X)
    pixels = np.random.default_rng(3).integers(500, 1500, (24, 32), np.uint16)
    for place in (folder, folder / "scene"):
        (place / "rgb").mkdir(parents=True)
        (place / "depth").mkdir()
    colour = np.repeat((pixels >> 3).astype(np.uint8)[..., None], 3, axis=2)
    for name in ("rgb.png", "rgb.jpg", "scene/rgb/000000.png"):
        cv2.imwrite(str(folder / name), colour)
    for name in ("depth.tiff", "scene/depth/000000.png"):
        cv2.imwrite(str(folder / name), pixels)
    np.save(folder / "depth.npy", pixels)
    camera = {"cam_K": [36.5, 0, 16, 0, 36.6, 12, 0, 0, 1], "depth_scale": 1.0}
    (folder / "scene" / "scene_camera.json").write_text(json.dumps({"0": camera}))
    with Results(PLAN, folder) as results:
        results.note(Happened.SESSION)
    return folder


@pytest.fixture(scope="module")
def value_of(sound: Path) -> Callable[[str], Any]:
    """What the sound file of a name says."""
    return {name: read(sound / name) for name, read in (READERS | CHECKSUMMED).items()}.__getitem__


@contextmanager
def _at_most(more: int) -> Iterator[None]:
    """Context in which this process may take as much more memory [B]."""
    before, pages = resource.getrlimit(resource.RLIMIT_AS), int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + more, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


_PIECES = st.sampled_from(
    [
        b"",
        b"\0",
        b"\xff\xfe",
        b"NaN",
        b"1e999",
        b"-1",
        b"[" * 3000,
        b"9" * 5000,
        b"null",
        b"{}",
        b"&a ",
        b"*a",
        b"\n",
        b"!!int ",
    ]
)


@seed(61)
@given(
    name=st.sampled_from(sorted(READERS | CHECKSUMMED)),
    edits=st.lists(
        st.tuples(st.floats(0, 1), st.integers(0, 40), _PIECES | st.binary(max_size=12)), min_size=1, max_size=4
    ),
)
@examples(500)
def test_any_mutation_ends_in_an_error_of_ours_or_in_a_value(
    name: str, edits: list[tuple[float, int, bytes]], sound: Path, value_of: Callable[[str], Any]
) -> None:
    path = sound / name
    before = data = path.read_bytes()
    for at, gone, piece in edits:
        place = round(at * len(data))
        data = data[:place] + piece + data[place + gone :]
    path.write_bytes(data)
    began = time.process_time()
    try:
        with _at_most(2**30):
            value = (READERS | CHECKSUMMED)[name](path)
        assert name not in CHECKSUMMED or value is None or value == value_of(name)
    except TooleeError as error:
        assert len(str(error)) < 20_000  # noqa: PT017 - whatever is raised is told
    finally:
        path.write_bytes(before)
    assert time.process_time() - began < LONGEST
