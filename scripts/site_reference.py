"""Reference pages that are generated when the site is built, so that they cannot fall behind the code.

A hook of mkdocs: `<!-- generated: NAME -->` in a page is replaced with what `PAGES[NAME]` writes.
`python scripts/site_reference.py NAME` prints one of them.
"""

from __future__ import annotations

import ast
import contextlib
import inspect
import io
import os
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import MISSING, fields
from enum import Enum
from pathlib import Path
from typing import Any, get_origin, get_type_hints

from toolee_robot import errors
from toolee_robot.station import StationConfig
from toolee_robot.station.schema import StationField, record_fields, record_in

MARKER = re.compile(r"^<!-- generated: ([a-z-]+) -->$", re.MULTILINE)
COMMAND_WIDTH = 80
ROOT = Path(__file__).parents[1]
ROOMS = ("toolee_robot", "control", "perception", "sim_backend")


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Called by mkdocs with a page's source."""
    return MARKER.sub(lambda match: PAGES[match[1]](), markdown)


# -- station file --------------------------------------------------------------------------------------------------


def station_file() -> str:
    """A table of fields for each section of the station file."""
    return "\n\n".join(_section(StationConfig, ""))


def records(config: type[Any]) -> Iterator[type[Any]]:
    """The dataclass `config` and all that its fields hold."""
    yield config
    for field in fields(config):
        if (kind := record_in(get_type_hints(config)[field.name])) is not None:
            yield from records(kind)


def _section(config: type[Any], name: str) -> Iterator[str]:
    path = tuple(name.split(".")) if name else ()
    if name:
        own = [field for field in record_fields(config, path) if len(field.path) == len(path) + 1]
        rows = "\n".join(map(_row, own))
        yield f"## `{name}`\n\n{_summary(config)}\n\n| field | type | default | meaning |\n|---|---|---|---|\n{rows}"
    for field in fields(config):
        hint = get_type_hints(config)[field.name]
        if (kind := record_in(hint)) is not None:
            child = f"{field.name}[]" if get_origin(hint) is tuple else field.name
            yield from _section(kind, f"{name}.{child}" if name else child)


def _row(field: StationField) -> str:
    return f"| `{field.path[-1]}` | {field.kind} | {_default(field.default)} | {field.text} |"


def _default(value: Any) -> str:
    if value is MISSING:
        return "*required*"
    value = value.value if isinstance(value, Enum) else value
    if isinstance(value, tuple):
        return f"`[{', '.join(f'{number:g}' for number in value)}]`"
    return f"`{value:.4g}`" if isinstance(value, float) else "`null`" if value is None else f"`{str(value).lower()}`"


def _summary(record: type[Any]) -> str:
    return inspect.getdoc(record) or ""


# -- command line --------------------------------------------------------------------------------------------------


def command_line() -> str:
    """The help of `toolee`, of its groups and of each of their commands."""
    from toolee_robot.cli.app import command_paths

    shown: list[str] = []
    group = ""
    for path in command_paths():
        if path[0] != group and len(path) == 2:
            shown.append(f"## toolee {path[0]}\n\n```text\n{command_help(path[:1])}\n```")
        group = path[0]
        head, _, options = command_help(path).partition("\n\n options\n")
        text, _, arguments = head.partition("\n\n positional arguments\n")
        usage, *prose = text.split("\n\n")
        shown.append(f"{'#' * (1 + len(path))} toolee {' '.join(path)}")
        shown.extend(map(_paragraph, prose))
        lines = [line for part in (arguments, options) for line in part.splitlines()[1:]]
        shown.append(f"```text\n{usage}\n\n" + "\n".join(lines) + "\n```")
    return "\n\n".join(shown)


def _paragraph(text: str) -> str:
    return f"```bash\n{text.removeprefix('Example: ')}\n```" if text.startswith("Example: ") else text


def command_help(path: tuple[str, ...]) -> str:
    """What `toolee PATH --help` prints, without colours, COMMAND_WIDTH columns wide."""
    from toolee_robot.cli import main

    out = io.StringIO()
    os.environ.update(COLUMNS=str(COMMAND_WIDTH), NO_COLOR="1", TERM="dumb")
    with contextlib.redirect_stdout(out), contextlib.suppress(SystemExit):
        main([*path, "--help"])
    return "\n".join(line.rstrip() for line in out.getvalue().strip().splitlines())


# -- errors --------------------------------------------------------------------------------------------------------


def error_table() -> str:
    """Every error, indented under the one that it is a kind of; then the codes that say more than its class."""
    specific = _specific_codes()
    kinds = list(_kinds(errors.TooleeError, 0))
    rows = "\n".join(
        f"| {'&nbsp;' * 4 * depth}`{kind.__name__}` | `{kind.code}` | {_meaning(kind)} |" for kind, depth in kinds
    )
    codes = "\n".join(
        f"- `{kind.__name__}`: {', '.join(f'`{code}`' for code in sorted(specific[kind.__name__]))}"
        for kind, _ in kinds
        if specific.get(kind.__name__)
    )
    return f"| error | code | meaning |\n|---|---|---|\n{rows}\n\n## More specific codes\n\n{codes}"


def _kinds(kind: type[errors.TooleeError], depth: int) -> Iterator[tuple[type[errors.TooleeError], int]]:
    """An error and all that are kinds of it, each with its depth in the hierarchy."""
    yield kind, depth
    for child in kind.__subclasses__():
        if child.__module__ == errors.__name__ and child.__bases__[0] is kind:
            yield from _kinds(child, depth + 1)


def _meaning(kind: type[errors.TooleeError]) -> str:
    return " ".join((inspect.getdoc(kind) or "").split("\n\n")[0].split())


def _specific_codes() -> dict[str, set[str]]:
    """Error class -> codes that the package's code gives it by `code="..."`."""
    found: dict[str, set[str]] = {}
    for path in (path for room in ROOMS for path in (ROOT / room).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                codes = [k.value.value for k in node.keywords if k.arg == "code" and isinstance(k.value, ast.Constant)]
                found.setdefault(node.func.id, set()).update(map(str, codes))
    return found


PAGES: dict[str, Callable[[], str]] = {
    "station-file": station_file,
    "command-line": command_line,
    "errors": error_table,
}

if __name__ == "__main__":
    print(PAGES[sys.argv[1]]())
