"""YAML files read into records, and the lines of their fields for messages."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import Field, fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar, cast, get_args, get_type_hints

import yaml
from pydantic import TypeAdapter, ValidationError

from toolee_robot.errors import ConfigError, words_of
from toolee_robot.runtime.files import read_text
from toolee_robot.types.units import shown


class YamlLines:
    """Where the fields of a YAML file are. Of a file that cannot be read nothing is told.

    Args:
        path: The file.
    """

    def __init__(self, path: Path) -> None:
        try:
            self._root = yaml.compose(read_text(path), yaml.SafeLoader)
        except (OSError, ValueError, RecursionError, yaml.YAMLError):
            self._root = None

    def told(self, place: Sequence[int | str]) -> str:
        """Tell the line of a field or, where the file leaves it out, that of its section.

        Args:
            place: Names and indices that lead to the field, the outermost first.

        Returns:
            Such as "line 14", or "`camera` begins in line 12"; empty where not even the section is there.
        """
        node, line, found = self._root, 0, 0
        for step in place:
            inner = _inner(node, step)
            if inner is None:
                break
            (mark, node), found = inner, found + 1
            line = mark.line + 1
        if not found:
            return ""
        if found == len(place):
            return f"line {line}"
        return f"`{'.'.join(map(str, place[:found]))}` begins in line {line}"


def _inner(node: Any, step: int | str) -> tuple[Any, Any] | None:
    """Where a field of a mapping or an item of a list begins, and its node; None where there is none."""
    if isinstance(node, yaml.MappingNode):
        return next(((key.start_mark, value) for key, value in node.value if key.value == step), None)
    if isinstance(node, yaml.SequenceNode) and isinstance(step, int) and step < len(node.value):
        return node.value[step].start_mark, node.value[step]
    return None


T = TypeVar("T")
IN_FILE = "in_file"
"""Key in a dataclass field's metadata: its name in the file, where that is another one; empty where it has none."""

_ADAPTERS: dict[type[Any], TypeAdapter[Any]] = {}
"""To make one of a whole station takes longer than to read one."""


class _UniqueKeys(yaml.SafeLoader):
    """Refuses a key that is given twice, of which YAML would silently take the last one."""

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        try:
            return super().construct_object(node, deep)
        except (ValueError, LookupError, AttributeError) as error:  # such as 2026-02-30, or !!bool abc
            raise yaml.constructor.ConstructorError(None, None, f"no value: {error}", node.start_mark) from None

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and (key.tag, str(key.value)) in seen:
                message = f"the key {key.value!r} is given twice"
                raise yaml.constructor.ConstructorError(None, None, message, key.start_mark)
            seen.add((key.tag, str(key.value)))
        return super().construct_mapping(node, deep)


def read_yaml(path: Path, what: str) -> Any:
    """Read a YAML file; JSON is YAML.

    Args:
        path: The file.
        what: Description of the file for the error message.

    Returns:
        What the file holds: mappings, lists and scalars.

    Raises:
        ConfigError: It cannot be read, or gives a key twice.
    """
    try:
        return yaml.load(read_text(path), _UniqueKeys)  # a SafeLoader
    except FileNotFoundError:
        raise ConfigError(f"there is no {what} {path}") from None
    except RecursionError:
        message = f"cannot read the {what} {path}: it is nested too deeply"
        raise ConfigError(message) from None
    except (OSError, ValueError, yaml.YAMLError) as error:
        why = words_of(error).replace('in "<unicode string>", ', "")
        raise ConfigError(f"cannot read the {what} {path}: {why}") from error


def read_record(path: Path, kind: type[T], what: str) -> T:
    """Read a configuration record from a YAML file; omitted fields keep their defaults.

    Args:
        path: The file.
        kind: The record, a dataclass.
        what: What the file describes, for the errors.

    Returns:
        The record, validated.

    Raises:
        ConfigError: It cannot be read, or a field is wrong; the message names every one.
    """
    return to_record(read_yaml(path, f"{what}'s file") or {}, path, kind, what)


def to_record(data: Any, path: Path, kind: type[T], what: str) -> T:
    """Convert the data of a YAML or JSON file to a record.

    Args:
        data: What the file holds.
        path: The file, for the errors.
        kind: The record, a dataclass.
        what: What the file describes, for the errors.

    Returns:
        The record, validated.

    Raises:
        ConfigError: A field is wrong; the message names every one, and its line where the file is there to be read.
    """
    try:
        if kind not in _ADAPTERS:
            _ADAPTERS[kind] = TypeAdapter(kind)
        return cast(T, _ADAPTERS[kind].validate_python(data))
    except ValidationError as error:
        lines = YamlLines(path)
        wrong = [
            f"  {_said(kind, e['loc'], e)}" + (f" ({where})" if (where := lines.told(e["loc"])) else "")
            for e in error.errors()
        ]
        raise ConfigError(f"{path} is not a valid {what}:\n" + "\n".join(wrong)) from error


def _said(kind: type[Any], loc: Sequence[int | str], error: Any) -> str:
    """An error of pydantic in words for the person who wrote the file."""
    match error["type"]:
        case "missing":
            text = "is missing"
        case "unexpected_keyword_argument":
            near = difflib.get_close_matches(str(loc[-1]), _names_at(kind, loc[:-1]), 1)
            text = "there is no such field" + (f": did you mean {near[0]}?" if near else "")
        case "string_type":
            text = f"a text is needed, {shown(error['input'])} is not one: put it in quotes"
        case "dataclass_type":
            text = "fields with their values are needed, such as `name: value`"
        case "value_error":
            text = str(error["ctx"]["error"])
        case _:
            text = error["msg"]
    name = ".".join(map(str, loc))
    return f"{name}: {text}" if name else text


def _names_at(kind: Any, loc: Sequence[int | str]) -> list[str]:
    """Names of the fields of the record at a place in another."""
    for step in loc:
        hint = get_type_hints(kind).get(step) if is_dataclass(kind) and isinstance(step, str) else None
        inner = [part for part in (hint, *get_args(hint)) if is_dataclass(part)]
        if not inner:
            return []
        kind = inner[0]
    return [name for field in fields(kind) if (name := name_in_file(field))] if is_dataclass(kind) else []


def name_in_file(field: Field[Any]) -> str:
    """Tell what a record's field is called in its YAML file.

    Args:
        field: The field of a dataclass.

    Returns:
        The name; empty for a field that the program alone sets.
    """
    return str(field.metadata.get(IN_FILE, field.name))
