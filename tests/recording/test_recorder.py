"""The recording, read back with mcap's own reader."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation
from toolee_robot.recording.schemas import SCHEMAS

from tests.errors import raises
from toolee_robot.errors import UserError
from toolee_robot.frames import transform
from toolee_robot.hal import MotionOutcome, MotionReport
from toolee_robot.recording.recorder import RunRecorder
from toolee_robot.types import CameraIntrinsics, RgbdFrame

INTRINSICS = CameraIntrinsics(365.5, 365.5, 15.5, 11.5, 32, 24)


def messages(path: Path) -> dict[str, list[tuple[int, str, dict[str, Any]]]]:
    """topic -> (log time [ns], schema, content)."""
    found: dict[str, list[tuple[int, str, dict[str, Any]]]] = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert schema is not None
            assert channel.message_encoding == "json"
            assert schema.encoding == "jsonschema"
            content = json.loads(message.data)
            assert set(content) == set(json.loads(schema.data)["properties"]), schema.name
            found.setdefault(channel.topic, []).append((message.log_time, schema.name, content))
    return found


def test_images_come_back_as_they_were(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 256, (24, 32, 3), dtype=np.uint8)
    depth = rng.uniform(0.3, 2.0, (24, 32)).astype(np.float32)
    depth[0, 0], depth[0, 1], depth[0, 2] = np.nan, 0.0, np.inf
    path = tmp_path / "run.mcap"
    with RunRecorder(path) as recorder:
        recorder.record_frame(RgbdFrame(rgb, depth, INTRINSICS, stamp=1.25))
    found = messages(path)
    time, schema, image = found["/camera/rgb"][0]
    assert (time, schema) == (1_250_000_000, "foxglove.CompressedImage")
    assert image["timestamp"] == {"sec": 1, "nsec": 250_000_000}
    bgr = cv2.imdecode(np.frombuffer(base64.b64decode(image["data"]), np.uint8), cv2.IMREAD_COLOR)
    assert bgr is not None
    np.testing.assert_array_equal(bgr[..., ::-1], rgb)
    raw = found["/camera/depth"][0][2]
    assert (raw["encoding"], raw["step"], raw["width"], raw["height"]) == ("16UC1", 64, 32, 24)
    depth_mm = np.frombuffer(base64.b64decode(raw["data"]), "<u2").reshape(24, 32)
    np.testing.assert_array_equal(depth_mm[0, :3], 0)
    np.testing.assert_allclose(depth_mm[1:] * 1e-3, depth[1:], atol=0.51e-3)
    calibration = found["/camera/calibration"][0][2]
    np.testing.assert_allclose(np.reshape(calibration["K"], (3, 3)), INTRINSICS.matrix)


def test_poses_clouds_joints_contacts_and_events_come_back(tmp_path: Path) -> None:
    X = transform(Rotation.from_rotvec([0.1, -0.2, 0.3]), [0.4, 0.5, 0.6])
    points = np.random.default_rng(1).normal(size=(50, 3))
    path = tmp_path / "run.mcap"
    with RunRecorder(path, {"seed": "7"}) as recorder:
        recorder.record_pose(2.0, "base", "ee", X)
        recorder.record_cloud(2.0, "camera", points)
        recorder.record_hypotheses(2.0, "camera", np.stack([X, X]))
        recorder.record_joints(2.0, ("a", "b"), np.array([0.1, 0.2]), "/hand/joints")
        recorder.record_contact(2.1, 88.0, X)
        recorder.record_event(2.2, "blow", {"number": np.int64(3), "offsets": np.array([1.0, np.nan]), "flush": True})
        recorder.record_log(2.3, "flush", "warning")
    found = messages(path)
    (tf,) = found["/tf"][0][2]["transforms"]
    assert (tf["parent_frame_id"], tf["child_frame_id"]) == ("base", "ee")
    R = Rotation.from_quat([tf["rotation"][k] for k in "xyzw"])
    np.testing.assert_allclose(transform(R, [tf["translation"][k] for k in "xyz"]), X, atol=1e-12)
    cloud = found["/perception/cloud"][0][2]
    back = np.frombuffer(base64.b64decode(cloud["data"]), "<f4").reshape(-1, cloud["point_stride"] // 4)
    np.testing.assert_allclose(back, points, atol=1e-6)
    assert len(found["/perception/hypotheses"][0][2]["poses"]) == 2
    assert found["/hand/joints"][0][2]["position"] == {"a": 0.1, "b": 0.2}
    assert found["/contacts"][0][2]["force"] == 88.0
    assert found["/events"][0][2]["data"] == {"number": 3, "offsets": [1.0, None], "flush": True}
    assert found["/log"][0][2]["level"] == 3
    with path.open("rb") as file:
        (metadata,) = make_reader(file).iter_metadata()
    assert metadata.metadata == {"seed": "7"}


def test_a_motion_is_thinned_but_keeps_the_peak_of_the_strike(tmp_path: Path) -> None:
    n = 500
    wrenches = np.zeros((n, 6))
    wrenches[237, 2] = 420.0
    q = np.linspace(0, 1, n)[:, None] * np.ones(6)
    report = MotionReport(MotionOutcome.CONTACT, 3.0 + np.arange(n) / 500, q, q, wrenches)
    names = tuple("abcdef")
    with RunRecorder(tmp_path / "run.mcap") as recorder:
        recorder.record_motion("strike", report, names)
    found = messages(tmp_path / "run.mcap")
    assert 100 <= len(found["/arm/wrench"]) <= 130
    assert max(m["force"]["z"] for _, _, m in found["/arm/wrench"]) == 420.0
    assert found["/arm/measured"][-1][2]["position"]["f"] == pytest.approx(1.0)
    assert found["/events"][0][2]["data"] == {"name": "strike", "outcome": "contact"}


def test_what_was_not_commanded_is_not_recorded_as_a_command(tmp_path: Path) -> None:
    """A robot that stops by itself is sent nothing: the last command must not seem to stand still."""
    n, sent, rate = 200, 120, 125
    q = (0.5 * np.arange(n) / rate)[:, None] * np.ones(6)
    commanded = np.minimum(q, q[sent - 1])
    report = MotionReport(
        MotionOutcome.STOPPED, 3.0 + np.arange(n) / rate, commanded, q, np.zeros((n, 6)), commands=sent
    )
    with RunRecorder(tmp_path / "run.mcap") as recorder:
        recorder.record_motion("strike", report, tuple("abcdef"))
    found = messages(tmp_path / "run.mcap")
    recorded = [m["position"]["a"] for _, _, m in found["/arm/commanded"]]
    assert recorded[-1] == pytest.approx(q[sent - 1, 0], abs=0.5 / rate)
    assert np.all(np.diff(recorded) > 0.0)
    assert found["/arm/measured"][-1][2]["position"]["a"] == q[-1, 0]


def test_an_exception_leaves_a_complete_file(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"

    def job() -> None:
        with RunRecorder(path) as recorder:
            recorder.record_event(0.0, "started")
            assert not path.exists()
            raise RuntimeError("robot")

    with pytest.raises(RuntimeError, match="robot"):
        job()
    assert len(messages(path)["/events"]) == 1
    assert [p.name for p in tmp_path.iterdir()] == ["run.mcap"]


def test_nothing_is_left_when_the_file_cannot_be_finished(tmp_path: Path) -> None:
    """The place is taken by a folder: the rename fails, and the unfinished file goes."""
    path = tmp_path / "run.mcap"

    def job() -> None:
        with RunRecorder(path) as recorder:
            recorder.record_event(0.0, "started")
            path.mkdir()

    with pytest.raises(OSError, match=r"run\.mcap"):
        job()
    assert [p.name for p in tmp_path.iterdir()] == ["run.mcap"]


def test_unwritable_place_and_bad_stamp_are_refused(tmp_path: Path) -> None:
    with raises(UserError, code="user.recording_not_writable"), RunRecorder(tmp_path / "no" / "such" / "run.mcap"):
        pass
    with RunRecorder(tmp_path / "run.mcap") as recorder, pytest.raises(ValueError, match="clock"):
        recorder.record_event(float("nan"), "started")
    with pytest.raises(RuntimeError, match="with"):
        recorder.record_event(0.0, "late")


def test_schemas_are_named_as_foxglove_knows_them() -> None:
    assert {name for name in SCHEMAS if name.startswith("foxglove.")} == {
        f"foxglove.{name}"
        for name in (
            "CompressedImage",
            "RawImage",
            "CameraCalibration",
            "FrameTransforms",
            "PointCloud",
            "PosesInFrame",
            "Log",
        )
    }
