"""`toolee rehearse hammer` from outside: the station's own drivers, every device emulated, a nail driven."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import yaml
from mcap.reader import make_reader

# A nail that stands out little, and few looks: at its default real-time factor a second of the job takes four of the
# clock on the wall.
LAB = Path(__file__).parents[2] / "examples" / "lab.yaml"


def _start(folder: Path, model: str, *args: str) -> subprocess.Popen[str]:
    said = yaml.safe_load(LAB.read_text())
    said["arm"]["model"] = model
    said["work"]["nail_protrusion"] = 0.004
    said["task"] = {"views": 1, "views_again": 1}
    (folder / "short.yaml").write_text(yaml.safe_dump(said))
    code = "from toolee_robot.cli import main; main()"
    options = ["--variant", "perfect_perception", "--seed", "101", "--json", *args]
    return subprocess.Popen(
        [sys.executable, "-c", code, "rehearse", "hammer", "short.yaml", *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
        start_new_session=True,  # a group of its own, for signals
    )


def _record(out: str) -> dict[str, Any]:
    (line,) = out.splitlines()
    return dict(json.loads(line))


def _host(said: str) -> str:
    """Where the stand-in of the controller was."""
    return str(re.findall(r"controller at (127[\d.]+)", said)[0])


def _nobody_serves(host: str) -> bool:
    with socket.socket() as probe:
        probe.settimeout(1.0)
        return probe.connect_ex((host, 30004)) != 0


@pytest.mark.realtime
@pytest.mark.nightly
@pytest.mark.parametrize(("robot", "profile"), [("UR10", "ideal"), ("UR10", "harsh"), ("UR10e", "harsh")])
def test_the_nail_is_driven_through_the_real_driver(robot: str, profile: str, tmp_path: Path) -> None:
    """The acceptance: handover, looks, touches and strikes over the unmodified ur_rtde, to a flush nail."""
    process = _start(tmp_path, robot, "--profile", profile)
    out, err = process.communicate(timeout=1500)
    record = _record(out)
    assert process.returncode == 0, err
    assert (record["success"], record["outcome"], record["nail"]) == (True, "flush", "flush")
    assert (record["arm"], record["robot"], record["controller_profile"]) == ("ur-rtde", robot, profile)
    assert record["strikes"] >= 3
    assert record["strike_offset_mm"] < 6.0
    assert record["contact_speed"] > 0.9
    assert "Traceback" not in err
    assert "pybullet build" not in err
    assert _nobody_serves(_host(err)), "the stand-in ends with the job"
    assert "expect " in err.split("connecting to")[0], "how long it takes is said first"
    folder = next((tmp_path / "runs").iterdir())
    assert sorted(p.name for p in folder.iterdir()) == ["picture.png", "recording.mcap", "summary.json"]
    summary = json.loads((folder / "summary.json").read_text())
    ratios = [strike["load"]["collision_ratio"] for strike in summary["strike_log"]]
    assert all(ratio is None or ratio < 0.6 for ratio in ratios)
    assert (ratios[0] is not None) == (robot == "UR10e"), "a CB3 has no ratios"
    stamps = [strike["stamp"] for strike in summary["strike_log"]]
    truths = [strike["stamp"] for strike in summary["strike_truth"]]
    # One clock for task, driver, controller and judge: each strike is felt when it happens, give or take the link. (A
    # strike on a flush nail meets the wood: the judge does not count it.)
    assert len(truths) >= 3
    for truth in truths:
        assert min(abs(stamp - truth) for stamp in stamps) < 0.3
    with (folder / "recording.mcap").open("rb") as file:
        counts = make_reader(file).get_summary()
        assert counts is not None
        assert counts.statistics is not None
        topics = {c.topic: counts.statistics.channel_message_counts[i] for i, c in counts.channels.items()}
    assert topics["/arm/measured"] > 500


@pytest.mark.realtime
@pytest.mark.parametrize("sign", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.nightly)])
def test_an_interrupt_stops_the_arm_and_ends_client_and_server_in_order(tmp_path: Path, sign: signal.Signals) -> None:
    """Ctrl-C in a terminal, or the end of a service, reaches every process of the job."""
    process = _start(tmp_path, "UR10")
    assert process.stderr is not None
    said = ""
    for text in process.stderr:
        said += text
        if text.startswith("Handover"):
            break
    time.sleep(1.0)
    os.killpg(process.pid, sign)
    out, err = process.communicate(timeout=60)
    record = _record(out)
    assert process.returncode == 130, err
    assert (record["success"], record["outcome"]) == (False, "interrupted")
    assert "the arm was stopped" in record["reason"]
    assert "Traceback" not in err
    assert _nobody_serves(_host(said))
