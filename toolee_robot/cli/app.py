"""Entry point: finds the command, parses its options, runs it, converts errors to messages and exit codes.

Exit codes: 0 done; 1 the job failed; 2 invalid input (an option, a file); 130 interrupted (the arm was stopped).

`toolee --help` imports no command, and `toolee GROUP ...` only the group's module. Such a module has `COMMANDS`: by the
group's name the class of each of its commands by name, or the class of a group that is itself a command. The module's
docstring is the group's help, the class's docstring the command's.
"""

from __future__ import annotations

import errno
import json
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import import_module
from math import isfinite
from types import ModuleType
from typing import Protocol

from toolee_robot.cli import EXIT_INTERRUPTED, INTERRUPTED_LINE
from toolee_robot.errors import TooleeError, UserError, words_of

EXIT_FAILED, EXIT_USER = 1, 2
WIDEST = 100
"""Longest line of prose in a help [characters]."""
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)

_OF_EXTRA = {"isal": "train", "faster_coco_eval": "train", "rerun": "viewer", "rerun_cli": "viewer", "viser": "viewer"}
"""Module -> the extra of this package that brings it."""
GROUPS: dict[str, tuple[str, str]] = {
    "sim": ("jobs", "Do a job in simulation; nothing real moves"),
    "rehearse": ("jobs", "Do a job with your station file on emulated devices"),
    "run": ("jobs", "Do a job with the real robot; the arm moves"),
    "station": ("station", "Write, check, show and upgrade the station file of a lab"),
    "doctor": ("doctor", "Check a station before any motion: robot, devices, computer"),
    "arm": ("arm", "Move a UR arm slowly, for its bring-up"),
    "hand": ("hand", "Read, open or close the hand of a station"),
    "camera": ("camera", "Find, show and record an RGB-D camera"),
    "calibrate": ("calibrate", "Measure where camera, tool tip and nail are"),
    "trials": ("trials", "Run the jobs of a plan, and write their report"),
    "replay": ("replay", "Show a recorded run"),
    "estimate": ("estimate", "Find tools and their poses in your own RGB-D files"),
    "annotate": ("estimate", "Click the tools in your own frames, to test on them"),
    "dataset": ("dataset", "Make a synthetic data set"),
    "train": ("train", "Train the perception's networks"),
    "evaluate": ("evaluate", "Measure the perception on a data set"),
    "devices": ("doctor", "List the drivers that a station file may name"),
    "emulate": ("emulate", "Emulate a UR controller, or a hand, for a driver to talk to"),
}
"""Name of a group -> its module in this package, and one line for `toolee --help`."""


class Command(Protocol):
    """A command with its options: a dataclass. With a field `json` its errors are told as JSON, too."""

    def run(self) -> int:
        """Run it and return the exit code."""


def run(args: Sequence[str] | None = None, start: Callable[[], None] = lambda: None) -> int:
    """Run `toolee` and return the exit code; only the parser itself exits (0 for --help, 2 for a bad option).

    Args:
        args: The arguments; None for those of the process.
        start: Called before the command runs.
    """
    words = sys.argv[1:] if args is None else list(args)
    as_json = "--json" in words
    try:
        command = parse(words)
        as_json = getattr(command, "json", False)
        start()
        return command.run()
    except SystemExit as stop:
        if as_json and stop.code == EXIT_USER:
            _print_error(UserError.code, "invalid options: standard error says which")
        raise
    except KeyboardInterrupt:
        print("Interrupted.", file=sys.stderr)
        if as_json:
            print(INTERRUPTED_LINE, end="", flush=True)
        return EXIT_INTERRUPTED
    except Exception as error:
        told = _told(error)
        if as_json:
            _print_error(told.code if told else "internal", str(told or f"{type(error).__name__}: {error}"))
        if told is None:
            raise
        _complain(told)
        return EXIT_USER if isinstance(told, UserError) else EXIT_FAILED


def parse(words: Sequence[str]) -> Command:
    """Find the command and parse its options.

    Args:
        words: The arguments after `toolee`.

    Returns:
        The command.

    Raises:
        UserError: There is no such command.
        SystemExit: The help was printed (0), or the command or an option of it is missing or invalid (2).
    """
    if not words or words[0] in ("-h", "--help"):
        summaries = {name: summary for name, (_, summary) in GROUPS.items()}
        _list((), "A robot that is handed a hammer, looks at it, and drives the nail.", summaries, asked=bool(words))
    name, *rest = words
    if name not in GROUPS:
        raise _unknown(name, GROUPS, ())
    commands = _commands(name)
    if not isinstance(commands, Mapping):
        return _parse_options(commands, (name,), rest)
    if not rest or rest[0] in ("-h", "--help"):
        summaries = {name: _joined(command.__doc__).split("\n")[0] for name, command in commands.items()}
        _list((name,), _module(name).__doc__ or "", summaries, asked=bool(rest))
    if rest[0] not in commands:
        raise _unknown(rest[0], commands, (name,))
    return _parse_options(commands[rest[0]], (name, rest[0]), rest[1:])


def command_paths() -> Iterator[tuple[str, ...]]:
    """The words of each command, in the order of the help."""
    for group in GROUPS:
        commands = _commands(group)
        if isinstance(commands, Mapping):
            yield from ((group, name) for name in commands)
        else:
            yield (group,)


def _commands(group: str) -> type[Command] | Mapping[str, type[Command]]:
    found: type[Command] | Mapping[str, type[Command]] = _module(group).COMMANDS[group]
    return found


def _module(group: str) -> ModuleType:
    return import_module(f"toolee_robot.cli.{GROUPS[group][0]}")


def _parse_options(command: type[Command], path: tuple[str, ...], words: Sequence[str]) -> Command:
    import tyro

    described, config = _wrapped(command.__doc__), (tyro.conf.FlagCreatePairsOff,)
    # Of a docstring's line ends tyro keeps those before a digit, a dash or a bracket, and it wraps no description.
    tyro._strings.remove_single_line_breaks = lambda helptext: helptext if helptext == described else _joined(helptext)
    prog = " ".join(("toolee", *path))
    parsed: Command = tyro.cli(command, prog=prog, description=described, args=words, config=config)
    for name, value in vars(parsed).items():
        for number in value if isinstance(value, tuple) else (value,):
            if isinstance(number, float) and not isfinite(number):
                raise UserError(f"--{name.replace('_', '-')} {number}: give a number")
        if name == "port" and isinstance(value, int) and not 0 < value < 2**16:
            raise UserError(f"--port {value}: give 1 to {2**16 - 1}")
    return parsed


def _joined(helptext: str | None) -> str:
    """A docstring with one line for each paragraph."""
    paragraphs = (helptext or "").split("\n\n")
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs).strip()


def _wrapped(helptext: str | None) -> str:
    """A docstring in lines that fit the terminal, but for examples, which are copied."""
    columns = min(shutil.get_terminal_size().columns, WIDEST)
    return "\n\n".join(
        paragraph if paragraph.startswith("Example: ") else textwrap.fill(paragraph, columns, break_on_hyphens=False)
        for paragraph in _joined(helptext).split("\n\n")
    )


def _list(path: tuple[str, ...], description: str, summaries: Mapping[str, str], *, asked: bool) -> None:
    """Print one line for each command of a group and exit."""
    stream = sys.stdout if asked else sys.stderr
    columns = shutil.get_terminal_size().columns
    call = " ".join(("toolee", *path, "COMMAND"))
    indent = max(map(len, summaries)) + 4
    print(f"usage: {call}     `{call} --help` says more", end="\n\n", file=stream)
    print(_wrapped(description), end="\n\n", file=stream)
    for name, summary in summaries.items():
        print(f"  {name:{indent - 4}}  {textwrap.shorten(summary, columns - indent, placeholder=' …')}", file=stream)
    raise SystemExit(0 if asked else EXIT_USER)


def _unknown(name: str, known: Mapping[str, object], path: tuple[str, ...]) -> UserError:
    """No such command; names those that have the name in another group, or one that is spelled alike."""
    from difflib import get_close_matches

    elsewhere = [other for other in command_paths() if other[-1] == name]
    meant = elsewhere or [(*path, other) for other in get_close_matches(name, known, n=1)]
    words = " or ".join(f"`toolee {' '.join(other)}`" for other in meant)
    call = " ".join(("toolee", *path))
    hint = f"did you mean {words}?" if meant else f"`{call} --help` lists the commands"
    return UserError(f"unknown command `{call} {name}`: {hint}")


def _told(error: Exception) -> TooleeError | None:
    """What a person is told of an error; None: it is a bug."""
    if isinstance(error, TooleeError):
        return error
    if isinstance(error, ModuleNotFoundError):
        return _missing_package(error.name or "")
    if isinstance(error, OSError) and (error.filename is not None or error.errno in FULL):
        return UserError(
            f"cannot use {error.filename or 'a file'}: {words_of(error)}; make room or choose another place"
        )
    return None


def _missing_package(module: str) -> UserError | None:
    """A module of another package is not installed; None if it is one of this project or of Python."""
    package = module.partition(".")[0]
    if package in ("", "toolee_robot") or package in sys.stdlib_module_names:
        return None
    extra = _OF_EXTRA.get(package)
    what = "." if extra is None else f"'.[{extra}]'"
    return UserError(
        f"this command needs the Python module {module}, which is not installed. Run `python -m pip install -e "
        f"{what}` in the repository. For `toolee estimate` alone, requirements-perception.txt is enough",
        code="user.missing_package",
    )


def _complain(error: TooleeError) -> None:
    from rich.console import Console
    from rich.markup import escape

    # Not wrapped, so that paths can be copied and searched for.
    Console(stderr=True, highlight=False).print(f"[bold red]error:[/bold red] {escape(str(error))}", soft_wrap=True)


def _print_error(code: str, message: str) -> None:
    print(json.dumps({"error": {"code": code, "message": message}}), flush=True)
