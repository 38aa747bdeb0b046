"""Every field of every record is documented: in an `Attributes:` section, or in a string below the field."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = [
    "control",
    "perception/detection",
    "perception/evaluation",
    "perception/pose",
    "perception/research",
    "perception/training",
    "perception/cloud.py",
    "perception/fit_trust.py",
    "perception/io.py",
    "perception/pipeline.py",
    "perception/trust.py",
    "scripts",
    "sim_backend",
    "toolee_robot/cli",
    "toolee_robot/config",
    "toolee_robot/doctor",
    "toolee_robot/faults",
    "toolee_robot/hal",
    "toolee_robot/hardware",
    "toolee_robot/motion",
    "toolee_robot/recording",
    "toolee_robot/runtime",
    "toolee_robot/stations",
    "toolee_robot/tasks",
    "toolee_robot/types",
    "toolee_robot/arm_data.py",
    "toolee_robot/depth_noise.py",
    "toolee_robot/end_effectors.py",
    "toolee_robot/findings.py",
    "toolee_robot/symmetry.py",
]
"""Rooms and files that the rule holds for; a room is added once its records are documented."""


def _is_record(node: ast.ClassDef) -> bool:
    """Whether a class is a dataclass or a NamedTuple."""
    names = [ast.unparse(d.func if isinstance(d, ast.Call) else d) for d in node.decorator_list]
    names += [ast.unparse(base) for base in node.bases]
    return any(name.rpartition(".")[2] in ("dataclass", "NamedTuple") for name in names)


def undocumented(source: str) -> Iterator[str]:
    """The public fields of the records in a module's source that nothing documents, as Class.field."""
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.ClassDef) or not _is_record(node):
            continue
        _, _, attributes = (ast.get_docstring(node) or "").partition("Attributes:\n")
        named = set(re.findall(r"^    (\w+):", attributes, re.M))
        following = [*node.body[1:], None]
        for statement, after in zip(node.body, following, strict=True):
            if not isinstance(statement, ast.AnnAssign) or not isinstance(statement.target, ast.Name):
                continue
            below = (
                isinstance(after, ast.Expr)
                and isinstance(after.value, ast.Constant)
                and isinstance(after.value.value, str)
            )
            field = statement.target.id
            if not field.startswith("_") and field not in named and not below:
                yield f"{node.name}.{field}"


@pytest.mark.parametrize("room", ROOMS)
def test_every_field_of_a_record_is_documented(room: str) -> None:
    path = ROOT / room
    files = sorted(path.rglob("*.py")) if path.is_dir() else [path]
    assert files
    missing = [f"{file.relative_to(ROOT)}: {name}" for file in files for name in undocumented(file.read_text())]
    assert missing == []


def test_a_field_that_nothing_documents_is_found() -> None:
    source = '''
@dataclass(frozen=True)
class Pose:
    """A pose.

    Attributes:
        x: Position [m].
    """

    x: float
    y: float
    z: float
    """Height [m]."""
'''
    assert list(undocumented(source)) == ["Pose.y"]
