"""Lines of a YAML file, for messages about its fields."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from toolee_robot.runtime.files import read_text


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
