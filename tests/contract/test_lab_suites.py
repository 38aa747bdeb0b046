"""The contract suites as they run on a lab's hand and at its door and switch, run on an emulated hand and a controller
stand-in, with somebody who does what is printed."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from threading import Event, Thread

import pytest

from tests.rigs.panel import Operator, Panel
from tests.stand_in import stand_in
from toolee_robot.doctor.machine import expected_robot
from toolee_robot.sim_backend.hands.ability import AbilityEmulator
from toolee_robot.station import sim_station
from toolee_robot.types import ArmModel

ROOT = Path(__file__).parents[2]
HOST = "127.0.0.25"
HAND = """
hand: {model: ability_hand, port: PORT,
  mounting: {position: [0.0, 0.0, 0.03], fingers: [0.0, 0.0, 1.0], thumb: [1.0, 0.0, 0.0]}}
"""
PERSON = f"""
arm: {{host: {HOST}}}
person: {{door_closed_input: 0, door_open_input: 1, hold_to_run_input: 2, hold_to_run_released_input: 3}}
"""
pytestmark = [pytest.mark.nightly, pytest.mark.realtime]


def suite(name: str, option: str, station: Path, act: Callable[[str], bool]) -> str:
    """Run a suite on a lab's device; `act` is shown each line, and says whether Enter is pressed after it."""
    command = [sys.executable, "-m", "pytest", "-n0", f"tests/contract/{name}", "-k", "lab", option, str(station)]
    lines = []
    with subprocess.Popen(
        command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as run:
        assert run.stdin is not None
        assert run.stdout is not None
        for line in run.stdout:
            lines.append(line)
            if act(line.strip()):
                run.stdin.write("\n")
                run.stdin.flush()
    said = "".join(lines)
    assert run.returncode == 0, said[-3000:]
    return said


def test_a_labs_hand_is_asked_as_the_emulators_are(tmp_path: Path) -> None:
    with AbilityEmulator() as emulator:
        (tmp_path / "lab.yaml").write_text(HAND.replace("PORT", emulator.port))

        def act(line: str) -> bool:
            if line.startswith("Hold a handle"):
                emulator.hold(55.0)
            elif line.startswith("Take hold"):
                emulator.hold(None)
            return line.endswith("Then press Enter.")

        said = suite("test_hand_contract.py", "--hand", tmp_path / "lab.yaml", act)
    assert "WILL OPEN AND CLOSE" in said
    assert "5 passed" in said


def test_a_hand_that_holds_nothing_fails(tmp_path: Path) -> None:
    with AbilityEmulator() as emulator:
        (tmp_path / "lab.yaml").write_text(HAND.replace("PORT", emulator.port))
        with pytest.raises(AssertionError, match="2 failed, 3 passed"):
            suite("test_hand_contract.py", "--hand", tmp_path / "lab.yaml", lambda line: "press Enter" in line)


def test_a_labs_person_is_asked_as_the_emulated_one_is(tmp_path: Path) -> None:
    (tmp_path / "lab.yaml").write_text(PERSON)
    payload, panel, over = expected_robot(sim_station()).payload, Panel(), Event()
    assert payload is not None
    operator = Operator(panel)

    def act(line: str) -> bool:
        operator.tell(line.replace("Open the door, and put", "Put"))
        return False

    with stand_in(ArmModel.UR10, HOST) as controller:
        controller.fault("payload", mass=payload.mass, cog=payload.center_of_mass.tolist())

        def wire() -> None:
            were = 0
            while not over.is_set():
                bits = panel.read(0.0)
                for number in range(4):
                    if (bits ^ were) >> number & 1:
                        controller.fault("digital_input", index=number, high=bool(bits >> number & 1))
                were = bits
                time.sleep(0.01)

        wiring = Thread(target=wire)
        wiring.start()
        try:
            said = suite("test_person_contract.py", "--person", tmp_path / "lab.yaml", act)
        finally:
            over.set()
            wiring.join()
    assert "7 passed, 2 skipped" in said
