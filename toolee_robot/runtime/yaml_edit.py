"""Fields of a YAML file, set in its text: everything else stays as it was written, to the byte.

So do the file's permissions, and a symbolic link to it: the file that the link leads to is written.

A library that reads a file with its comments and writes it anew would do less: ruamel.yaml 0.19 puts a field that is
added to a section under the heading comment of the next one, drops comments inside flow mappings of several lines,
indents the file in its own way, and writes the text `on` and the number 1e-05 so that YAML 1.1 reads something else.
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from toolee_robot.errors import ConfigError
from toolee_robot.runtime.files import written_whole
from toolee_robot.runtime.yaml_files import read_yaml

Value = float | str | None | Sequence[float]
"""What a field may be set to."""
_PLAIN = re.compile(r"[A-Za-z][\w./-]*( [\w./-]+)*")
_NULL = "tag:yaml.org,2002:null"


def set_fields(
    path: Path, section: tuple[str, ...], values: Mapping[str, Value], item: tuple[str, str] | None = None
) -> None:
    """Set fields of a section of a YAML file; where there is none, it is added after what is there.

    Args:
        path: The file; its top level is a mapping, or empty.
        section: Names of the section and of those around it, the outermost first; empty for the top level.
        values: Numbers, texts, lists of numbers or None, of the fields by name; other fields of the section stay.
        item: Set them in a record of a list of the section instead: the list's name, and the record's `name`.

    Raises:
        ConfigError: The file cannot be read, or has a layout that cannot be edited safely; nothing was written.
        UserError: The file cannot be written.
    """
    before = read_yaml(path, "file")
    try:
        wanted = part = {**(before or {})}
        for name in section:  # copies: what is shared by an alias stays as it is elsewhere
            part[name] = {**(part.get(name) or {})}
            part = part[name]
        if item is not None:
            part[item[0]] = [{**record} for record in part[item[0]]]
            part = next(record for record in part[item[0]] if record["name"] == item[1])
        part.update(values)
        text, newline = _text_of(path)
        edited = _edited(text, section, values, item)
        done = bool(yaml.safe_load(edited) == wanted)
    except (yaml.YAMLError, AttributeError, KeyError, StopIteration, TypeError, ValueError):
        done = False
    if not done:
        raise _not_editable(path, _by_hand(section, values, item))
    _write(path, edited, newline)


def add_first(path: Path, name: str, value: Value) -> None:
    """Add a field to a YAML file, before all others of its top level.

    Args:
        path: The file; its top level is a mapping without this field, or empty.
        name: Name of the field.
        value: Its value.

    Raises:
        ConfigError: The file cannot be read, or has a layout that cannot be edited safely; nothing was written.
        UserError: The file cannot be written.
    """
    before = read_yaml(path, "file")
    try:
        text, newline = _text_of(path)
        edited = _preceded(text, {name: value})
        done = name not in (before or {}) and bool(yaml.safe_load(edited) == {name: value, **(before or {})})
    except (yaml.YAMLError, TypeError, ValueError):
        done = False
    if not done:
        raise _not_editable(path, _block({name: value}, ""))
    _write(path, edited, newline)


def _text_of(path: Path) -> tuple[str, str]:
    """The text with lines that end in \\n, and how they end in the file; mixed ends stay as they are."""
    text = path.read_bytes().decode()
    if "\n" in text and text.count("\r\n") == text.count("\n"):
        return text.replace("\r\n", "\n"), "\r\n"
    return text, "\n"


def _write(path: Path, text: str, newline: str) -> None:
    place = path.resolve()  # a link stays one
    with written_whole(place) as scratch:
        scratch.touch(mode=0o600)  # nobody reads it before it has the file's permissions
        scratch.write_bytes(text.replace("\n", newline).encode())
        shutil.copymode(place, scratch)


def _not_editable(path: Path, lines: str) -> ConfigError:
    message = f"{path} has a layout that is not edited here: enter it by hand:\n{lines}"
    return ConfigError(message, code="config.not_editable")


def _preceded(text: str, new: dict[str, Any]) -> str:
    root = yaml.compose(text, yaml.SafeLoader)
    if root is None:  # an empty file
        return _inserted(text, len(text), _block(new, ""))
    if not isinstance(root, yaml.MappingNode):
        raise TypeError(text)
    begin = root.start_mark.index
    if root.flow_style:
        return f"{text[: begin + 1]}{_text(new)[1:-1]}{', ' if root.value else ''}{text[begin + 1 :]}"
    return f"{text[:begin]}{_block(new, '')}\n{' ' * root.start_mark.column}{text[begin:]}"


def _by_hand(section: tuple[str, ...], values: Mapping[str, Value], item: tuple[str, str] | None) -> str:
    if item is not None:
        return f"{'.'.join(section)}.{item[0]}, {item[1]}:\n{_block(values, '  ')}"
    return _block(_nested(section, values), "")


def _nested(section: Sequence[str], values: Mapping[str, Value]) -> dict[str, Any]:
    nested: dict[str, Any] = dict(values)
    for name in reversed(section):
        nested = {name: nested}
    return nested


def _edited(text: str, section: tuple[str, ...], values: Mapping[str, Value], item: tuple[str, str] | None) -> str:
    root = node = yaml.compose(text, yaml.SafeLoader)
    key, rest = None, list(section)
    while node is not None and rest and rest[0] in (fields := _fields(node)):
        key, node = fields[rest.pop(0)]
    if item is not None:
        records = _fields(node)[item[0]][1].value
        node = next(record for record in records if _fields(record)["name"][1].value == item[1])
    new = _nested(rest, values)
    if node is None:  # an empty file
        return _inserted(text, len(text), _block(new, ""))
    if node.tag == _NULL and key is not None:  # a section without fields
        begin, end = node.start_mark.index, node.end_mark.index
        if begin < end:
            return f"{text[:begin]}{_text(new)}{text[end:]}"
        return _inserted(text, _line_end(text, begin), _block(new, " " * (key.start_mark.column + 2)))
    if not isinstance(node, yaml.MappingNode):
        raise TypeError(section)
    fields = _fields(node)
    missing = {name: value for name, value in new.items() if name not in fields}
    edited = text if not missing else _added(text, node, missing, outermost=node is root)
    for name in sorted(new.keys() & fields.keys(), key=lambda name: fields[name][1].start_mark.index, reverse=True):
        begin, end = fields[name][1].start_mark.index, _end(fields[name][1])
        edited = f"{edited[:begin]}{' ' if begin == end else ''}{_text(new[name])}{edited[end:]}"
    return edited


def _added(text: str, node: yaml.MappingNode, missing: dict[str, Any], *, outermost: bool) -> str:
    """Add fields after the last one of a mapping that has none of them."""
    if node.flow_style:
        at = node.end_mark.index - 1
        return f"{text[:at]}{', ' if node.value else ''}{_text(missing)[1:-1]}{text[at:]}"
    column = node.value[0][0].start_mark.column
    at = len(text) if outermost else _line_end(text, _end(node))
    while not outermost and re.match(rf"\n {{{column},}}#", text[at:]):  # comments of this section's own
        at = _line_end(text, at + 1)
    return _inserted(text, at, _block(missing, " " * column))


def _fields(node: Any) -> dict[str, tuple[Any, Any]]:
    """The nodes of a mapping's keys and values, by key."""
    return {key.value: (key, value) for key, value in node.value} if isinstance(node, yaml.MappingNode) else {}


def _end(node: Any) -> int:
    """Where a node's own text ends; the end that the parser tells of a block is where the next one begins."""
    if isinstance(node, yaml.ScalarNode) or node.flow_style:
        return int(node.end_mark.index)
    last = node.value[-1]
    return _end(last[1] if isinstance(last, tuple) else last)


def _line_end(text: str, at: int) -> int:
    end = text.find("\n", at)
    return len(text) if end < 0 else end


def _inserted(text: str, at: int, lines: str) -> str:
    """Text with whole lines after the one that ends, or begins, at a place."""
    before, after = text[:at], text[at:]
    return f"{before}{'' if before.endswith(chr(10)) or not before else chr(10)}{lines}{after or chr(10)}"


def _block(values: Mapping[str, Any], indent: str) -> str:
    """Fields in block style, without the last line's end."""
    lines = []
    for name, value in values.items():
        inner = f"\n{_block(value, indent + '  ')}" if isinstance(value, dict) else f" {_text(value)}"
        lines.append(f"{indent}{name}:{inner}")
    return "\n".join(lines)


def _text(value: Any) -> str:
    """A value as YAML 1.1 reads it, in flow style: a number has a point before its exponent."""
    if value is None:
        return "null"
    if isinstance(value, str):
        plain = _PLAIN.fullmatch(value) and yaml.safe_load(value) == value
        return value if plain else json.dumps(value, ensure_ascii=False)
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{name}: {_text(v)}' for name, v in value.items())}}}"
    if isinstance(value, Sequence):
        return f"[{', '.join(_text(v) for v in value)}]"
    text = str(int(value)) if float(value).is_integer() and abs(value) < 1e15 else repr(float(value))
    return text if "e" not in text or "." in text else text.replace("e", ".0e")
