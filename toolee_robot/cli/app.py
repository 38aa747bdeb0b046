"""Entry point: parses the arguments, runs the command, converts errors to messages and exit codes.

Exit codes: 0 done; 1 the job failed; 2 invalid input (an option, a file); 130 interrupted (the arm was stopped).
"""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Sequence
from types import FrameType
from typing import Annotated

import tyro
from rich.console import Console
from rich.markup import escape

from toolee_robot.cli.annotate import Annotate
from toolee_robot.cli.arm.command import Arm
from toolee_robot.cli.bench.bent_nails import BenchBentNails
from toolee_robot.cli.bench.calibration import BenchCalibration
from toolee_robot.cli.bench.command import Bench
from toolee_robot.cli.bench.nail import BenchNail
from toolee_robot.cli.bench.servo import BenchServo
from toolee_robot.cli.bench.swing import BenchSwing
from toolee_robot.cli.calibrate.command import Calibrate
from toolee_robot.cli.camera.command import Camera
from toolee_robot.cli.dataset import Dataset
from toolee_robot.cli.devices import Devices
from toolee_robot.cli.doctor import Doctor
from toolee_robot.cli.estimate import Estimate
from toolee_robot.cli.evaluate import Evaluate
from toolee_robot.cli.faults import Faults
from toolee_robot.cli.hammering.command import Hammer
from toolee_robot.cli.hand.command import Hand
from toolee_robot.cli.hand_emulator import HandEmulator
from toolee_robot.cli.replaying.replay import Replay
from toolee_robot.cli.replaying.runs import Runs
from toolee_robot.cli.station.command import Station
from toolee_robot.cli.train.command import Train
from toolee_robot.cli.trials import Trials
from toolee_robot.cli.ur_controller import UrController
from toolee_robot.errors import TooleeError, UserError

EXIT_FAILED, EXIT_USER, EXIT_INTERRUPTED = 1, 2, 130

Command = (
    Annotated[Hammer, tyro.conf.subcommand("hammer")]
    | Annotated[Estimate, tyro.conf.subcommand("estimate")]
    | Annotated[Annotate, tyro.conf.subcommand("annotate")]
    | Annotated[Arm, tyro.conf.subcommand("arm")]
    | Annotated[Bench, tyro.conf.subcommand("bench")]
    | Annotated[BenchCalibration, tyro.conf.subcommand("bench-calibration")]
    | Annotated[BenchNail, tyro.conf.subcommand("bench-nail")]
    | Annotated[BenchBentNails, tyro.conf.subcommand("bench-bent-nails")]
    | Annotated[BenchServo, tyro.conf.subcommand("bench-servo")]
    | Annotated[BenchSwing, tyro.conf.subcommand("bench-swing")]
    | Annotated[Camera, tyro.conf.subcommand("camera")]
    | Annotated[Calibrate, tyro.conf.subcommand("calibrate")]
    | Annotated[Dataset, tyro.conf.subcommand("dataset")]
    | Annotated[Devices, tyro.conf.subcommand("devices")]
    | Annotated[Doctor, tyro.conf.subcommand("doctor")]
    | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
    | Annotated[Faults, tyro.conf.subcommand("faults")]
    | Annotated[Hand, tyro.conf.subcommand("hand")]
    | Annotated[HandEmulator, tyro.conf.subcommand("hand-emulator")]
    | Annotated[Replay, tyro.conf.subcommand("replay")]
    | Annotated[Runs, tyro.conf.subcommand("runs")]
    | Annotated[Station, tyro.conf.subcommand("station")]
    | Annotated[Train, tyro.conf.subcommand("train")]
    | Annotated[Trials, tyro.conf.subcommand("trials")]
    | Annotated[UrController, tyro.conf.subcommand("ur-controller")]
)

AnyCommand = (
    Hammer
    | Estimate
    | Annotate
    | Arm
    | Bench
    | BenchCalibration
    | BenchNail
    | BenchBentNails
    | BenchServo
    | BenchSwing
    | Camera
    | Calibrate
    | Dataset
    | Devices
    | Doctor
    | Evaluate
    | Faults
    | Hand
    | HandEmulator
    | Replay
    | Runs
    | Station
    | Train
    | Trials
    | UrController
)


def main(args: Sequence[str] | None = None) -> None:
    """Run `toolee` and exit with the command's exit code.

    Args:
        args: The arguments; None for those of the process.
    """
    _let_threads_sleep()
    try:
        code = run(args)
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader of the output has closed the pipe (`| head`): prevent an error in the interpreter's final flush.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = EXIT_FAILED
    sys.exit(code)


def run(args: Sequence[str] | None = None) -> int:
    """Run `toolee` and return the exit code; only the parser itself exits (0 for --help, 2 for a bad option).

    Args:
        args: The arguments; None for those of the process.
    """
    command: AnyCommand = tyro.cli(
        Command,
        prog="toolee",
        description="A robot that is handed a hammer, looks at it, and drives the nail.",
        args=args,
        config=(tyro.conf.FlagCreatePairsOff,),
    )
    console = Console(stderr=True, highlight=False)
    previous = signal.signal(signal.SIGTERM, _terminate)  # SIGTERM stops the arm as Ctrl-C does
    try:
        return command.run()
    except UserError as error:
        _complain(console, command, error, "user_error")
        return EXIT_USER
    except TooleeError as error:
        _complain(console, command, error, "error")
        return EXIT_FAILED
    except ModuleNotFoundError as error:
        if not _of_other_package(error):
            raise
        _complain(console, command, _missing_package(error), "user_error")
        return EXIT_USER
    except KeyboardInterrupt:
        console.print("[yellow]Interrupted.[/yellow]")
        return EXIT_INTERRUPTED
    finally:
        signal.signal(signal.SIGTERM, previous)


def _let_threads_sleep() -> None:
    """Let torch's waiting threads spin for some tens of microseconds, then sleep, unless the environment is set.

    Medians for a pose on 2 cores of a virtual machine: 26 ms with this setting, 52 ms with a tenth of the spins, 21 ms
    with endless spinning; beside a program that keeps one core busy 77, 40 and 225 ms. OpenMP reads the setting once,
    when torch is first imported, which no module of the command line does before its command runs.
    """
    if "OMP_WAIT_POLICY" not in os.environ:
        os.environ["OMP_WAIT_POLICY"] = "PASSIVE"
        os.environ.setdefault("GOMP_SPINCOUNT", "10000")


def _of_other_package(error: ModuleNotFoundError) -> bool:
    """Whether the missing module belongs to neither this project nor Python: its package is not installed."""
    package = (error.name or "").partition(".")[0]
    return package not in ("", "toolee_robot") and package not in sys.stdlib_module_names


def _missing_package(error: ModuleNotFoundError) -> UserError:
    return UserError(
        f"this command needs the Python module {error.name}, which is not installed: run "
        "`python -m pip install -e .` in the repository; requirements-perception.txt is enough for "
        "`toolee estimate` only",
        code="user.missing_package",
    )


def _terminate(_signum: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _complain(
    console: Console,
    command: AnyCommand,
    error: TooleeError,
    outcome: str,
) -> None:
    # Not wrapped, so that paths can be copied and searched for.
    console.print(f"[bold red]error:[/bold red] {escape(str(error))}", soft_wrap=True)
    if isinstance(command, Hammer) and command.json:
        failure = {"success": False, "outcome": outcome, "code": error.code, "reason": str(error), "seed": command.seed}
        print(json.dumps(failure))
