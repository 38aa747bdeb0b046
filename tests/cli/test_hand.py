"""`toolee hand` at emulated hands: what their fingers do, and who has to agree first."""

from __future__ import annotations

import io
import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from toolee_robot.cli.app import EXIT_FAILED, EXIT_USER, run
from toolee_robot.devices.hands import open_hand
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.hands import emulated_hand
from toolee_robot.sim_backend.hands.kit import HandEmulator, happen
from toolee_robot.station import HandConfig, load_station

EXAMPLES = Path(__file__).parents[2] / "examples"
PACES = {"inspire_rh56": 4.0, "ability_hand": 4.0, "shadow_right": 1.0}
"""Rate of the emulated motors' time."""
INSPIRE = EXAMPLES / "inspire.yaml"
TCP = "tcp://127.0.0.1:0"
BENT = {"inspire_rh56": "index_knuckle", "ability_hand": "index_knuckle", "shadow_right": "rh_FFJ3"}
"""A joint of each hand that is bent in the closed one."""


@contextmanager
def _emulated(station: Path, handle: float | None = None, port: str | None = None) -> Iterator[HandEmulator[Any]]:
    config, interval = _config(station, port), sys.getswitchinterval()
    sys.setswitchinterval(5e-4)  # driver and emulator are in this process
    try:
        with emulated_hand(config, pace=PACES[config.model]) as emulator:
            emulator.hold(handle)
            yield emulator
    finally:
        sys.setswitchinterval(interval)


def _config(station: Path, port: str | None) -> HandConfig:
    return replace(load_station(station).hand, port=port)


def _hand(
    capsys: pytest.CaptureFixture[str], station: Path, emulator: HandEmulator[Any], *words: str
) -> tuple[int, dict[str, Any]]:
    code = run(["hand", *words, "--station", str(station), "--port", emulator.port, "--json"])
    out = capsys.readouterr()
    return code, {**(json.loads(out.out.splitlines()[-1]) if out.out else {}), "said": out.err}


@pytest.mark.realtime(light=True)
@pytest.mark.parametrize(
    ("name", "port", "handle"),
    [
        ("inspire", None, 400.0),
        pytest.param("inspire", TCP, 400.0, marks=pytest.mark.nightly),
        pytest.param("ability", None, 55.0, marks=pytest.mark.nightly),
        pytest.param("shadow", None, 55.0, marks=pytest.mark.nightly),
    ],
    ids=["inspire-rs485", "inspire-modbus", "ability", "shadow"],
)
def test_every_hand_closes_on_a_handle_and_opens_again(
    name: str, port: str | None, handle: float, capsys: pytest.CaptureFixture[str]
) -> None:
    station = EXAMPLES / f"{name}.yaml"
    joint = BENT[_config(station, None).model]
    with _emulated(station, handle, port) as emulator:
        code, closed = _hand(capsys, station, emulator, "close", "--yes")
        assert code == 0, closed
        assert closed["holding"]
        assert max(closed["contact_forces"].values()) > 0
        code, opened = _hand(capsys, station, emulator, "open", "--yes")
        assert code == 0, opened
        assert not opened["holding"]
        assert opened["joints"][joint] < closed["joints"][joint] - 0.3
        code, state = _hand(capsys, station, emulator, "state")
        assert (code, state["holding"], state["fault"]) == (0, False, "")


@pytest.mark.nightly
@pytest.mark.realtime(light=True)
def test_what_one_command_gripped_the_next_one_finds_in_the_hand(
    capsys: pytest.CaptureFixture[str], keyboard: int
) -> None:
    """As after a job that ended with the hammer in the closed hand."""
    with _emulated(INSPIRE, 400.0) as emulator:
        assert _hand(capsys, INSPIRE, emulator, "close", "--yes")[0] == 0
        code, state = _hand(capsys, INSPIRE, emulator, "state")
        assert (code, state["holding"]) == (0, True)
        os.write(keyboard, b"y\n")
        code, told = _hand(capsys, INSPIRE, emulator, "open")
        assert code == EXIT_FAILED
        assert "not confirmed: nothing was moved" in told["said"]
        assert "The hand holds something." in told["said"]
        assert _hand(capsys, INSPIRE, emulator, "state")[1]["holding"]
        os.write(keyboard, b"yes\n")
        code, opened = _hand(capsys, INSPIRE, emulator, "open")
        assert (code, opened["holding"]) == (0, False)


@pytest.mark.realtime(light=True)
def test_a_fault_is_exit_1(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    with _emulated(INSPIRE) as emulator:
        happen(emulator, "heat index 75")
        assert run(["hand", "state", "--station", str(INSPIRE), "--port", emulator.port]) == EXIT_FAILED
        told = capsys.readouterr().out
        assert "75 °C" in told
        assert "index" in told[told.index("fault") :]


@pytest.mark.realtime(light=True)
@pytest.mark.parametrize("port", [None, pytest.param(TCP, marks=pytest.mark.nightly)], ids=["rs485", "modbus"])
def test_a_stall_is_cleared_once_a_person_has_looked(
    port: str | None, capsys: pytest.CaptureFixture[str], keyboard: int
) -> None:
    with _emulated(INSPIRE, port=port) as emulator:
        happen(emulator, "jam index")
        code, told = _hand(capsys, INSPIRE, emulator, "close", "--yes")
        assert code == EXIT_FAILED
        assert "index: stalled" in " ".join(told["said"].split())
        happen(emulator, "free index")
        os.write(keyboard, b"y\n")
        code, told = _hand(capsys, INSPIRE, emulator, "clear-faults")
        assert code == EXIT_FAILED
        assert "not confirmed" in told["said"]
        assert "stalled" in _hand(capsys, INSPIRE, emulator, "state")[1]["fault"]
        os.write(keyboard, b"yes\n")
        code, told = _hand(capsys, INSPIRE, emulator, "clear-faults")
        assert (code, told["fault"]) == (0, "")
        assert _hand(capsys, INSPIRE, emulator, "close", "--yes")[0] == 0


@pytest.mark.realtime(light=True)
def test_a_fault_that_cannot_be_cleared_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    with _emulated(INSPIRE) as emulator:
        happen(emulator, "heat index 75")
        code, told = _hand(capsys, INSPIRE, emulator, "clear-faults", "--yes")
    assert code == EXIT_FAILED
    assert "still has a fault (index: too hot)" in " ".join(told["said"].split())


@pytest.mark.realtime(light=True)
@pytest.mark.parametrize("name", ["ability", "shadow"])
def test_a_hand_that_keeps_no_faults_clears_none_and_nobody_is_asked(
    name: str, capsys: pytest.CaptureFixture[str], keyboard: int
) -> None:
    del keyboard  # a terminal at which nobody types
    station = EXAMPLES / f"{name}.yaml"
    with _emulated(station) as emulator:
        code, told = _hand(capsys, station, emulator, "clear-faults")
    assert code == EXIT_USER
    assert "cannot clear faults" in " ".join(told["said"].split())


@pytest.mark.realtime(light=True)
def test_two_programs_do_not_command_a_hand_on_a_serial_port(capsys: pytest.CaptureFixture[str]) -> None:
    with (
        _emulated(INSPIRE) as emulator,
        open_hand(_config(INSPIRE, emulator.port), HostClock()),
    ):
        code, told = _hand(capsys, INSPIRE, emulator, "open", "--yes")
    assert code == EXIT_FAILED
    assert "Close other programs that use it" in " ".join(told["said"].split())


@pytest.mark.nightly
@pytest.mark.realtime(light=True)
def test_a_lab_reads_the_efforts_of_its_shadow_hand_before_it_can_say_what_they_mean(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    station = tmp_path / "lab.yaml"
    station.write_text("version: 3\nhand: {model: shadow_right}\n")
    with _emulated(EXAMPLES / "shadow.yaml", 55.0) as emulator:
        code, empty = _hand(capsys, station, emulator, "efforts", "--seconds", "1")
        assert code == 0, empty
        assert len(empty["largest"]) == 20
        assert _hand(capsys, EXAMPLES / "shadow.yaml", emulator, "close", "--yes")[0] == 0
        code, holding = _hand(capsys, station, emulator, "efforts", "--seconds", "0.5")
        assert code == 0, holding
    assert holding["now"]["FFJ3"] > 2.0 * max(empty["largest"].values()) > 0.0, "more than what counts as a touch"
    assert all(holding["largest"][motor] >= now for motor, now in holding["now"].items())


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["efforts", "--station", str(INSPIRE)], "`toolee hand state` shows its forces in newtons"),
        (["efforts", "--station", str(EXAMPLES / "mount.yaml")], "no motors or sensors"),
        (["efforts", "--station", str(EXAMPLES / "shadow.yaml"), "--seconds", "0"], "a finite number above 0"),
        (["open", "--station", str(INSPIRE)], "standard input is not a terminal"),
        (["close", "--station", str(INSPIRE)], "standard input is not a terminal"),
        (["clear-faults", "--station", str(INSPIRE)], "standard input is not a terminal"),
        (["clear-faults", "--station", str(EXAMPLES / "mount.yaml")], "no motors or sensors"),
        (["open", "--station", str(EXAMPLES / "mount.yaml")], "no motors or sensors"),
        (["state", "--station", str(EXAMPLES / "lab.yaml")], "no motors or sensors"),
        (["state", "--station", "none.yaml"], "none.yaml"),
        (["state", "--station", str(INSPIRE), "--port", "ws://127.0.0.1:1"], "is not for inspire_rh56"),
    ],
)
def test_what_nobody_attends_or_has_no_fingers_is_exit_2(
    words: list[str], text: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    assert run(["hand", *words]) == EXIT_USER
    assert text in " ".join(capsys.readouterr().err.split())
