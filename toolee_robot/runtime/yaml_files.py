"""YAML files read into records."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import TypeAdapter, ValidationError

from toolee_robot.errors import ConfigError

T = TypeVar("T")


class _UniqueKeys(yaml.SafeLoader):
    """Refuses a key that is given twice, of which YAML would silently take the last one."""

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
        return yaml.load(path.read_text(), _UniqueKeys)  # a SafeLoader
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ConfigError(f"cannot read the {what} {path}: {error}", code="config.unreadable") from error


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
        ConfigError: A field is wrong; the message names every one.
    """
    try:
        return TypeAdapter(kind).validate_python(data)
    except ValidationError as error:
        lines = [f"  {'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors()]
        raise ConfigError(f"{path} is not a valid {what}:\n" + "\n".join(lines), code="config.invalid") from error
