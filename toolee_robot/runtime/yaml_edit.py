"""Fields of a section of a YAML file, replaced in its text so that comments and layout stay."""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from toolee_robot.errors import ConfigError
from toolee_robot.runtime.files import write_atomic
from toolee_robot.runtime.yaml_files import read_yaml

Value = float | str | Sequence[float]
"""What a field may be set to."""


def set_fields(path: Path, section: str, values: Mapping[str, Value], item: tuple[str, str] | None = None) -> None:
    """Set fields of a section of a YAML file; the section is added at its end where there is none.

    Args:
        path: The file; its top level is a mapping in block style, or empty.
        section: Name of the section, a mapping.
        values: Numbers, texts or lists of numbers of the fields by name; other fields of the section stay.
        item: Set them in a record of a list of the section instead: the list's name, and the record's `name`.

    Raises:
        ConfigError: The file cannot be read, or has a layout that cannot be edited safely; nothing was written.
        UserError: The file cannot be written.
    """
    before = read_yaml(path, "file") or {}
    text = path.read_text()
    wanted = copy.deepcopy(before)
    try:
        if item is None:
            wanted[section] = {**(wanted.get(section) or {}), **values}
        else:
            next(record for record in wanted[section][item[0]] if record["name"] == item[1]).update(values)
        edited = _edited(text, section, values, item)
        done = bool(yaml.safe_load(edited) == wanted)
    except (yaml.YAMLError, AttributeError, KeyError, StopIteration, TypeError, ValueError):
        done = False
    if not done:
        lines = "\n".join(f"  {name}: {_text(value)}" for name, value in values.items())
        where = section if item is None else f"{section}.{item[0]}, {item[1]}"
        message = f"{path} has a layout that is not edited here: enter it by hand:\n{where}:\n{lines}"
        raise ConfigError(message, code="config.not_editable")
    write_atomic(path, edited.encode())


def _edited(text: str, section: str, values: Mapping[str, Value], item: tuple[str, str] | None) -> str:
    root = yaml.compose(text, yaml.SafeLoader)
    node = None if root is None else _fields(root).get(section)
    if item is not None:
        records = _fields(node)[item[0]].value
        node = next(record for record in records if _fields(record)["name"].value == item[1])
    if node is None:
        body = "".join(f"  {name}: {_text(value)}\n" for name, value in values.items())
        return f"{text}{'' if text.endswith(chr(10)) or not text else chr(10)}{section}:\n{body}"
    if not isinstance(node, yaml.MappingNode):
        raise ValueError(section)
    fields = _fields(node)
    edits: list[tuple[int, int, str]] = []
    missing = {name: value for name, value in values.items() if name not in fields}
    for name in values.keys() - missing.keys():
        scalar = fields[name]
        edits.append((scalar.start_mark.index, scalar.end_mark.index, f"{_text(values[name])}"))
    if missing and node.flow_style:
        at, new = node.end_mark.index - 1, ", ".join(f"{name}: {_text(value)}" for name, value in missing.items())
        edits.append((at, at, f", {new}" if node.value else new))
    elif missing:
        first = node.value[0][0].start_mark
        new = "".join(f"{name}: {_text(value)}\n{' ' * first.column}" for name, value in missing.items())
        edits.append((first.index, first.index, new))
    for begin, end, new in sorted(edits, key=lambda edit: edit[0], reverse=True):
        text = text[:begin] + new + text[end:]
    return text


def _fields(node: Any) -> dict[str, Any]:
    """The values of a mapping node, by their keys."""
    return {key.value: value for key, value in node.value}


def _text(value: Value) -> str:
    """A number as YAML 1.1 reads it, which wants a point before an exponent; a text in quotes, as in JSON."""
    if isinstance(value, str):
        return json.dumps(value)
    if isinstance(value, Sequence):
        return f"[{', '.join(_text(v) for v in value)}]"
    text = str(int(value)) if float(value).is_integer() and abs(value) < 1e15 else repr(float(value))
    return text if "e" not in text or "." in text else text.replace("e", ".0e")
