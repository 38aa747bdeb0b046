"""The recording, read back with the readers of mcap and of Foxglove's schemas."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory
from scipy.spatial.transform import Rotation

from tests.errors import raises
from tests.examples import timed
from tests.recording import small_run
from toolee_robot.errors import UserError
from toolee_robot.frames import transform
from toolee_robot.hal import ArmStatus, MotionOutcome, MotionReport
from toolee_robot.recording.history import SeenStatus
from toolee_robot.recording.mcap_file import McapFile
from toolee_robot.recording.reading import read_history
from toolee_robot.recording.recorder import FLUSH_PERIOD, RunRecorder
from toolee_robot.types import RgbdFrame


def messages(path: Path) -> dict[str, list[tuple[int, str, Any]]]:
    """topic -> (log time [ns], schema, decoded message), by mcap's own reader."""
    found: dict[str, list[tuple[int, str, Any]]] = {}
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for schema, channel, message, content in reader.iter_decoded_messages():
            assert schema is not None
            assert (channel.message_encoding, schema.encoding) == ("protobuf", "protobuf")
            found.setdefault(channel.topic, []).append((message.log_time, schema.name, content))
    return found


def test_images_come_back_as_they_were(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 256, (24, 32, 3), dtype=np.uint8)
    depth = rng.uniform(0.3, 2.0, (24, 32)).astype(np.float32)
    depth[0, 0], depth[0, 1] = np.nan, 0.0
    path = tmp_path / "run.mcap"
    with RunRecorder(path) as recorder:
        recorder.record_frame(RgbdFrame(rgb, depth, small_run.INTRINSICS, stamp=1.25))
    found = messages(path)
    time_ns, schema, image = found["/camera/rgb"][0]
    assert (time_ns, schema) == (1_250_000_000, "foxglove.CompressedImage")
    assert (image.timestamp.seconds, image.timestamp.nanos) == (1, 250_000_000)
    bgr = cv2.imdecode(np.frombuffer(image.data, np.uint8), cv2.IMREAD_COLOR)
    assert bgr is not None
    np.testing.assert_array_equal(bgr[..., ::-1], rgb)
    raw = found["/camera/depth"][0][2]
    assert (raw.encoding, raw.step, raw.width, raw.height) == ("32FC1", 128, 32, 24)
    np.testing.assert_array_equal(np.frombuffer(raw.data, "<f4").reshape(24, 32), depth)
    np.testing.assert_allclose(np.reshape(found["/camera/calibration"][0][2].K, (3, 3)), small_run.INTRINSICS.matrix)


def test_a_run_comes_back(tmp_path: Path) -> None:
    history = read_history(small_run.write(tmp_path / "run.mcap"))
    assert history.complete
    assert history.metadata["seed"] == "7"
    assert (history.start, history.end) == pytest.approx((0.0, 4.3))
    reached = history.joints.at(1.6)
    assert reached is not None
    np.testing.assert_allclose(reached, small_run.REACHED)
    assert max(w[2] for _, w in history.wrenches) == 54.0
    (_, fused), (_, seen) = next(iter(history.in_hand)), next(iter(history.estimates))
    assert fused.X is not None
    np.testing.assert_allclose(fused.X, small_run.X_HAND_EE, atol=1e-12)
    np.testing.assert_allclose(seen.covariance, np.diag([1e-6] * 6))
    assert (seen.usable, seen.reason, seen.trust) == (True, "ok", 0.9)
    assert history.clouds.values[0].shape == (50, 3)
    assert len(history.hypotheses.values[0]) == 8
    assert history.protrusions.at(4.2) == 0.0123
    assert history.status.at(4.2) == SeenStatus("ready", None, None)
    assert [d.reason for _, d in history.decisions if d.name == "strike"] == ["strike 1: expected, 12.3 mm left, 54 N"]
    assert history.station().work.nail_protrusion == 0.020


def test_poses_joints_contacts_and_decisions_come_back(tmp_path: Path) -> None:
    X = transform(Rotation.from_rotvec([0.1, -0.2, 0.3]), [0.4, 0.5, 0.6])
    path = tmp_path / "run.mcap"
    with RunRecorder(path) as recorder:
        recorder.record_pose(2.0, "base", "ee", X)
        recorder.record_joints(2.0, ("a", "b"), np.array([0.1, 0.2]), "/hand/joints")
        recorder.record_contact(2.1, 88.0, X)
        recorder.record_decision(2.2, "strike", "why", {"number": np.int64(3), "offsets": np.array([1.0, np.nan])})
        recorder.record_log(2.3, "flush", "warning")
    found = messages(path)
    (tf,) = found["/tf"][0][2].transforms
    assert (tf.parent_frame_id, tf.child_frame_id) == ("base", "ee")
    R = Rotation.from_quat([getattr(tf.rotation, k) for k in "xyzw"])
    np.testing.assert_allclose(transform(R, [getattr(tf.translation, k) for k in "xyz"]), X, atol=1e-12)
    assert [(j.name, j.position) for j in found["/hand/joints"][0][2].joints] == [("a", 0.1), ("b", 0.2)]
    assert found["/contacts"][0][2].force == 88.0
    decision = found["/decisions"][0][2]
    assert (decision.name, decision.reason, decision.data) == ("strike", "why", '{"number": 3, "offsets": [1.0, null]}')
    assert found["/log"][0][2].level == 3


def test_a_motion_is_recorded_at_the_rate_of_the_servo(tmp_path: Path) -> None:
    n = 500
    wrenches, q = np.zeros((n, 6)), np.linspace(0, 1, n)[:, None] * np.ones(6)
    wrenches[237, 2] = 420.0
    ratios = np.linspace(0.0, 0.4, n)
    report = MotionReport(
        MotionOutcome.CONTACT, 3.0 + np.arange(n) / 500, q, q, wrenches, position_deviation_ratios=ratios,
        collision_ratios=0.5 * ratios,
    )  # fmt: skip
    with RunRecorder(tmp_path / "run.mcap") as recorder:
        recorder.record_motion("strike", report, tuple("abcdef"))
    found = messages(tmp_path / "run.mcap")
    assert len(found["/arm/wrench"]) == len(found["/arm/measured"]) == len(found["/arm/commanded"]) == n
    assert max(m.force.z for _, _, m in found["/arm/wrench"]) == 420.0
    assert found["/arm/measured"][-1][2].joints[5].position == 1.0
    ratio = found["/arm/stop_ratios"][-1][2]
    assert (ratio.position_deviation, ratio.collision) == (0.4, 0.2)
    assert found["/decisions"][0][2].reason == "strike: contact"


def test_velocities_torques_and_currents_come_back_where_the_arm_reports_them(tmp_path: Path) -> None:
    n, q = 40, np.zeros((40, 6))
    drawn = np.random.default_rng(0).normal(0.0, 5.0, (3, n, 6))
    stamps = 1.0 + np.arange(n) / 500
    bare = MotionReport(MotionOutcome.COMPLETED, stamps, q, q, q)
    full = replace(bare, stamps=2.0 + stamps, qd_measured=drawn[0], torques=drawn[1], currents=drawn[2])
    with RunRecorder(tmp_path / "run.mcap", {"seed": 7}) as recorder:
        recorder.record_motion("without", bare, tuple("abcdef"))
        recorder.record_motion("with", full, tuple("abcdef"))
    history = read_history(tmp_path / "run.mcap")
    assert (len(history.joints), len(history.commanded)) == (2 * n, 2 * n)
    for series, rows in zip((history.velocities, history.torques, history.currents), drawn, strict=True):
        assert series.stamps == pytest.approx(full.stamps)
        np.testing.assert_array_equal(series.values, rows)
    first, last = (messages(tmp_path / "run.mcap")["/arm/measured"][i][2].joints[0] for i in (0, -1))
    assert not first.HasField("velocity"), "0 would be a measurement"
    assert not last.HasField("effort"), "the torques are the commanded motion's"


def test_changes_of_the_safety_bits_are_recorded_when_they_came(tmp_path: Path) -> None:
    q, bits = np.zeros((50, 6)), np.where(np.arange(50) < 30, 1, 0x404)
    stamps = 1.0 + np.arange(50) / 500
    report = MotionReport(MotionOutcome.STOPPED, stamps, q, q, q, safety_bits=bits)
    stopped = small_run.status(1.2, status=ArmStatus.PROTECTIVE_STOP, safety_bits=0x404, error_code="C157A4")
    with RunRecorder(tmp_path / "run.mcap", {"seed": 7}) as recorder:
        recorder.record_motion("strike", report, tuple("abcdef"))
        recorder.record_status(stopped)
    history = read_history(tmp_path / "run.mcap")
    assert history.safety_bits.stamps == pytest.approx([1.0, 1.06])
    assert history.safety_bits.values == [1, 0x404]
    assert history.status.at(2.0) == SeenStatus("protective_stop", 0x404, "C157A4")


def test_a_status_from_before_codes_were_recorded_has_none(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    described = descriptor_pb2.FileDescriptorProto(
        name="toolee/recording.proto", package="toolee", syntax="proto3", dependency=["google/protobuf/timestamp.proto"]
    )
    status = described.message_type.add(name="ArmStatus")
    kinds = {"timestamp": 11, "status": 9, "digital_inputs": 13}
    for number, (name, kind) in enumerate(kinds.items(), 1):
        status.field.add(name=name, number=number, label=1, type=kind)
    status.field[0].type_name = ".google.protobuf.Timestamp"
    time_file = descriptor_pb2.FileDescriptorProto.FromString(Timestamp.DESCRIPTOR.file.serialized_pb)
    schema = descriptor_pb2.FileDescriptorSet(file=[time_file, described]).SerializeToString()
    pool = descriptor_pool.DescriptorPool()
    pool.Add(time_file)
    pool.Add(described)
    old = message_factory.GetMessageClass(pool.FindMessageTypeByName("toolee.ArmStatus"))
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_metadata("run", {"seed": "7"})
        channel = writer.register_channel(
            "/arm/status", "protobuf", writer.register_schema("toolee.ArmStatus", "protobuf", schema)
        )
        writer.add_message(channel, 10**9, old(status="ready", digital_inputs=5).SerializeToString(), 10**9)
        writer.finish()  # type: ignore[no-untyped-call]
    assert read_history(path).status.at(1.0) == SeenStatus("ready", None, None)


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
    recorded = [m.joints[0].position for _, _, m in found["/arm/commanded"]]
    assert len(recorded) == sent
    assert np.all(np.diff(recorded) > 0.0)
    assert found["/arm/measured"][-1][2].joints[0].position == q[-1, 0]


_WRITES_UNTIL_KILLED = """
import itertools, sys, time
from pathlib import Path
from toolee_robot.recording.recorder import RunRecorder
from tests.recording import small_run
recorder = RunRecorder(Path(sys.argv[1]), {"seed": 7}).__enter__()
small_run.record(recorder)
for i in itertools.count():
    recorder.record_decision(5.0 + 0.01 * i, "tick", f"tick {time.time()}")
    time.sleep(0.01)
"""


@timed
def test_after_a_kill_all_but_the_last_second_can_be_read(tmp_path: Path, timed: bool) -> None:
    path = tmp_path / "run.mcap"
    process = subprocess.Popen([sys.executable, "-c", _WRITES_UNTIL_KILLED, str(path)])
    try:
        deadline = time.monotonic() + 60.0
        while not path.exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        time.sleep(3.5)
    finally:
        os.kill(process.pid, signal.SIGKILL)
        killed = time.time()
        process.wait()
    history = read_history(path)
    assert not history.complete
    assert history.station().work.nail_protrusion == 0.020
    ticks = [d.reason for _, d in history.decisions if d.name == "tick"]
    last = float(ticks[-1].split()[1])
    assert not timed or killed - last < FLUSH_PERIOD + 0.5


@pytest.mark.nightly
def test_who_records_waits_for_neither_encoding_nor_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten seconds of a 500 Hz servo, and a frame: handed over in less than one cycle of it, by a disk that hangs."""
    n = 5000
    q = np.zeros((n, 6))
    report = MotionReport(MotionOutcome.COMPLETED, np.arange(n) / 500, q, q, np.zeros((n, 6)))
    frame = RgbdFrame(np.zeros((24, 32, 3), np.uint8), np.ones((24, 32), np.float32), small_run.INTRINSICS, stamp=10.0)
    answers, writes = threading.Event(), McapFile.write
    written: list[str] = []

    def hanging(self: McapFile, topic: str, *rest: Any) -> None:
        assert answers.wait(60.0)
        written.append(topic)
        writes(self, topic, *rest)

    monkeypatch.setattr(McapFile, "write", hanging)
    shortest = np.inf
    with RunRecorder(tmp_path / "run.mcap") as recorder:
        for _ in range(5):
            began = time.thread_time()  # of a processor: another program may have it for a moment
            recorder.record_motion("strike", report, tuple("abcdef"))
            recorder.record_frame(frame)
            shortest = min(shortest, time.thread_time() - began)
        assert not written
        answers.set()
    assert shortest < 1 / 500
    assert written.count("/camera/rgb") == 5


def test_a_minute_at_500_hz_takes_less_than_20_mb(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    n = 3000  # 6 s
    q = np.cumsum(rng.normal(0.0, 1e-3, (n, 6)), axis=0)
    wrenches = rng.normal(0.0, 3.0, (n, 6))
    ratios = rng.uniform(0.0, 0.3, n)
    velocities, torques, currents = rng.normal(0.0, 1.0, (3, n, 6))
    report = MotionReport(
        MotionOutcome.COMPLETED, np.arange(n) / 500, q, q + rng.normal(0.0, 1e-5, (n, 6)), wrenches,
        position_deviation_ratios=ratios, collision_ratios=ratios, qd_measured=velocities, torques=torques,
        currents=currents, safety_bits=rng.integers(0, 2, n),
    )  # fmt: skip
    path = tmp_path / "run.mcap"
    with RunRecorder(path) as recorder:
        recorder.record_motion("strike", report, [f"shoulder_{i}_joint" for i in range(6)])
    assert 10 * path.stat().st_size < 20e6, "noise in every sample: a real robot's compresses better"


def test_an_exception_leaves_a_complete_file(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"

    def job() -> None:
        with RunRecorder(path) as recorder:
            recorder.record_decision(0.0, "started", "")
            raise RuntimeError("robot")

    with pytest.raises(RuntimeError, match="robot"):
        job()
    assert len(messages(path)["/decisions"]) == 1


_FILLS_THE_DISK = """
import json, resource, sys
from pathlib import Path
import numpy as np
from toolee_robot.recording.recorder import RunRecorder
from tests.recording import small_run
folder, told = Path(sys.argv[1]), []
resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, 1_000_000))
with RunRecorder(folder / "run.mcap", {"seed": 7}, told.append) as recorder:
    small_run.record(recorder)
    for i in range(100):
        recorder.record_decision(5.0 + i, "noise", np.random.default_rng(i).bytes(20_000).hex())
        if i % 5 == 0:
            recorder._queue.put(recorder._file.flush)
assert recorder.stopped
print(json.dumps(told))
"""


def test_a_full_disk_ends_the_recording_but_not_the_job(tmp_path: Path) -> None:
    """It is said once and at once, what was recorded stays, and there is room for the summary."""
    command = [sys.executable, "-c", _FILLS_THE_DISK, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    (told,) = json.loads(done.stdout)
    assert "recording has stopped, the job goes on: File too large" in told
    assert "run.mcap" in told
    assert (tmp_path / "run.mcap").stat().st_size < 1_000_000 - 64 * 1024
    history = read_history(tmp_path / "run.mcap")
    assert not history.complete
    assert history.station().work.nail_protrusion == 0.020
    assert len(history.joints) == 252


def test_an_error_in_a_message_ends_the_recording_but_not_the_job(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with RunRecorder(tmp_path / "run.mcap", {"seed": 7}) as recorder:
        recorder.record_decision(0.0, "before", "")
        recorder.record_joints(1.0, ("a", "b"), np.zeros(1))
        recorder.record_decision(2.0, "after", "")
    assert "recording has stopped" in recorder.stopped
    assert recorder.stopped in caplog.text
    assert [d.name for _, d in read_history(tmp_path / "run.mcap").decisions] == ["before"]


def test_unwritable_place_bad_stamp_and_no_recording_are_refused(tmp_path: Path) -> None:
    with raises(UserError, says="cannot write the recording"), RunRecorder(tmp_path / "no" / "such" / "run.mcap"):
        pass
    with RunRecorder(tmp_path / "run.mcap") as recorder, pytest.raises(ValueError, match="clock"):
        recorder.record_decision(float("nan"), "started", "")
    with pytest.raises(RuntimeError, match="with"):
        recorder.record_decision(0.0, "late", "")
