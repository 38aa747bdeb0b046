"""A whole job's recording: in Rerun, in the browser, and after a kill."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from importlib import import_module
from pathlib import Path

import pytest

from tests.viewer.logged import Logged
from toolee_robot.recording.reading import read_history
from toolee_robot.viewer.run_view import RunView

pytestmark = pytest.mark.nightly

_MAIN = "from toolee_robot.cli import main; main()"


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a whole job."""
    out = tmp_path_factory.mktemp("runs")
    command = [sys.executable, "-c", _MAIN, "sim", "hammer", "--seed", "100", "--json", "--out", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=1200.0, check=True)
    assert json.loads(done.stdout)["success"]
    (folder,) = out.iterdir()
    return folder


def test_every_message_is_read_by_the_libraries_of_mcap_and_foxglove(job: Path) -> None:
    """Checksums, order and number; each of Foxglove's messages by its published schema, which knows every field."""
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    count, newest, seen = 0, 0, set()
    with (job / "recording.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        for schema, channel, message, content in reader.iter_decoded_messages():
            assert schema is not None
            assert message.log_time >= newest
            count, newest = count + 1, message.log_time
            package, _, name = schema.name.partition(".")
            if package == "foxglove":
                published = getattr(import_module(f"foxglove_schemas_protobuf.{name}_pb2"), name)
                known = published.FromString(message.data)
                known.DiscardUnknownFields()
                assert known.ByteSize() == len(message.data), channel.topic
                stamped = known.transforms if name == "FrameTransforms" else [known]
                assert {one.timestamp.ToNanoseconds() for one in stamped} == {message.log_time}, channel.topic
                seen.add(name)
            else:
                assert content.DESCRIPTOR.full_name == schema.name
    assert summary is not None
    assert summary.statistics is not None
    assert count == summary.statistics.message_count > 10_000
    assert len(seen) == 8, "all kinds that are recorded"


def test_it_opens_in_rerun(job: Path, tmp_path: Path) -> None:
    """By Rerun's own reader, which knows images, poses, points, the pinhole and every other message's fields."""
    rerun = str(Path(sys.executable).parent / "rerun")
    env = os.environ | {"HOME": str(tmp_path), "FORCE_ANALYTICS": "0"}
    rrd = tmp_path / "run.rrd"
    convert = [rerun, "mcap", "convert", str(job / "recording.mcap"), "-o", str(rrd)]
    subprocess.run(convert, check=True, env=env, timeout=300.0)
    subprocess.run([rerun, "rrd", "verify", str(rrd)], check=True, env=env, timeout=300.0)
    shown = subprocess.run(
        [rerun, "rrd", "print", "-vv", str(rrd)], check=True, env=env, timeout=300.0, capture_output=True, text=True
    ).stdout
    for known in ("EncodedImage", "Image", "Pinhole", "Points3D", "InstancePoses3D", "Transform3D", "TextLog"):
        assert f"archetype: {known}" in shown, known
    for topic in ("/arm/measured", "/arm/commanded", "/arm/wrench", "/decisions", "/perception/estimates"):
        assert topic in shown


def test_a_killed_job_is_shown_up_to_its_last_second(tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-c",
        _MAIN,
        "sim",
        "hammer",
        "--seed",
        "100",
        "--variant",
        "perfect_perception",
        "--out",
        ".",
    ]
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        deadline = time.monotonic() + 300.0
        while time.monotonic() < deadline and process.poll() is None:
            found = [p for p in tmp_path.glob(".*/recording.mcap") if p.stat().st_size > 1e6]
            if found:
                break
            time.sleep(0.1)
    finally:
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    (killed,) = tmp_path.glob(".*/recording.mcap")
    history = read_history(killed)
    assert not history.complete
    assert len(history.joints) > 500
    logged = Logged(tmp_path / "run.rrd")
    RunView(logged.stream, history, history.station()).update()
    assert "The run was killed" in logged.read()["now"][-1][1]["text"][0]
