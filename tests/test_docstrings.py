"""Docstrings are complete: fields of records, and arguments, results and errors of public functions."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = (
    "control",
    "examples",
    "perception",
    "scripts",
    "sim_backend",
    *sorted(
        str(path.relative_to(ROOT))
        for path in (ROOT / "toolee_robot").iterdir()
        if not path.is_symlink() and (path.suffix == ".py" or (path / "__init__.py").is_file())
    ),
)
"""Rooms and files of the product."""
WITHOUT_SECTIONS = {
    "examples": "each is one screen long",
    "sim_backend/ur_controller/urscript/functions": "the arguments are those of the URScript manual",
}
"""Rooms whose functions need no sections, and why."""


def files_of(room: str) -> list[Path]:
    """The Python files of a room."""
    path = ROOT / room
    return sorted(path.rglob("*.py")) if path.is_dir() else [path]


def _bases(node: ast.ClassDef) -> list[str]:
    return [ast.unparse(base).partition("[")[0].rpartition(".")[2] for base in node.bases]


def _is_record(node: ast.ClassDef) -> bool:
    """Whether a class is a dataclass or a NamedTuple."""
    names = [ast.unparse(d.func if isinstance(d, ast.Call) else d) for d in node.decorator_list]
    return any(name.rpartition(".")[2] in ("dataclass", "NamedTuple") for name in [*names, *_bases(node)])


def undocumented(source: str) -> Iterator[str]:
    """The public fields of the public records in a module's source that nothing documents, as Class.field."""
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.ClassDef) or node.name.startswith("_") or not _is_record(node):
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


class Classes:
    """The classes of the product by name: which are the project's errors, and what a method inherits."""

    def __init__(self, sources: Iterable[str]) -> None:
        self._classes: dict[str, list[ast.ClassDef]] = {}
        for source in sources:
            for node in ast.walk(ast.parse(source)):
                if isinstance(node, ast.ClassDef):
                    self._classes.setdefault(node.name, []).append(node)

    def _bases_of(self, node: ast.ClassDef) -> Iterator[ast.ClassDef]:
        """All base classes; where several classes have a base's name, all of these."""
        for name in _bases(node):
            for base in self._classes.get(name, []):
                if base.name != node.name:
                    yield base
                    yield from self._bases_of(base)

    def is_error(self, name: str) -> bool:
        """Whether a class of this name is the project's error."""
        return name == "TooleeError" or any(
            "TooleeError" in _bases(node) or any("TooleeError" in _bases(base) for base in self._bases_of(node))
            for node in self._classes.get(name, [])
        )

    def inherits_docstring(self, node: ast.ClassDef, method: str) -> bool:
        """Whether a base class documents a method."""
        return any(
            isinstance(member, ast.FunctionDef) and member.name == method and ast.get_docstring(member)
            for base in self._bases_of(node)
            for member in base.body
        )


def _room(path: str) -> str:
    """The room of a file or a module's path: a package of the project, and what stands alone within it."""
    own = path.removeprefix("toolee_robot/")
    for part in ("perception/offline", "sim_backend/ur_controller"):
        if own.startswith(part):
            return part
    return own.partition("/")[0].removesuffix(".py")


def names_from_other_rooms(sources: Mapping[str, str]) -> set[tuple[str, str]]:
    """Which names are imported from another room: pairs of the room that has them, and the name."""
    found = set()
    for path, source in sources.items():
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("toolee_robot."):
                room = _room((node.module or "").replace(".", "/"))
                if room != _room(path):
                    found |= {(room, alias.name) for alias in node.names}
    return found


def _raised(function: ast.FunctionDef) -> set[str]:
    """Names of the classes that a function itself raises, not those of nested functions."""
    names: set[str] = set()
    waiting: list[ast.AST] = list(function.body)
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.Lambda):
            continue
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            names.add(ast.unparse(node.exc.func).rpartition(".")[2])
        waiting.extend(ast.iter_child_nodes(node))
    return names


def _functions(body: list[ast.stmt], owner: ast.ClassDef | None = None) -> Iterator[tuple[ast.FunctionDef, str, str]]:
    """Public functions with their qualified name and docstring; that of a constructor is its class's."""
    for node in body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from _functions(node.body, node)
        elif isinstance(node, ast.FunctionDef):
            name = f"{owner.name}.{node.name}" if owner else node.name
            if node.name == "__init__" and owner is not None:
                yield node, name, ast.get_docstring(owner) or ""
            elif not node.name.startswith("_") and not any(".setter" in ast.unparse(d) for d in node.decorator_list):
                yield node, name, ast.get_docstring(node) or ""


def missing_sections(source: str, classes: Classes, names: Callable[[str], bool]) -> Iterator[str]:
    """The sections that the docstrings of a module's public functions lack, as "function: section"."""
    tree = ast.parse(source)
    owners = {id(member): node for node in ast.walk(tree) if isinstance(node, ast.ClassDef) for member in node.body}
    for function, name, docstring in _functions(tree.body):
        if not names(name.partition(".")[0]):
            continue
        owner = owners.get(id(function))
        if docstring.startswith("See `") or (
            owner is not None and not docstring and classes.inherits_docstring(owner, function.name)
        ):
            continue
        a = function.args
        parameters = [
            p for p in (*a.posonlyargs, *a.args, *a.kwonlyargs, a.vararg) if p and p.arg not in ("self", "cls")
        ]
        returns = "None" if function.returns is None else ast.unparse(function.returns)
        if len(parameters) >= 2:
            if "Args:" not in docstring:
                yield f"{name}: Args"
            elif returns not in ("None", "NoReturn") and not re.search("^Whether|Returns:|Yields:", docstring):
                yield f"{name}: Returns"
        if function.name == "run" and not docstring:
            continue  # of a command: its class is the help, and the command line turns errors into exit codes
        described = docstring.partition("Raises:")[2]
        yield from (
            f"{name}: Raises {error}"
            for error in sorted(_raised(function))
            if classes.is_error(error) and error not in described
        )


@pytest.mark.parametrize("room", ROOMS)
def test_every_field_of_a_record_is_documented(room: str) -> None:
    files = files_of(room)
    assert files
    missing = [f"{file.relative_to(ROOT)}: {name}" for file in files for name in undocumented(file.read_text())]
    assert missing == []


@pytest.fixture(scope="module")
def imported() -> set[tuple[str, str]]:
    return names_from_other_rooms({str(f.relative_to(ROOT)): f.read_text() for room in ROOMS for f in files_of(room)})


@pytest.fixture(scope="module")
def classes() -> Classes:
    return Classes(file.read_text() for room in ROOMS for file in files_of(room))


@pytest.mark.parametrize("room", [room for room in ROOMS if room not in WITHOUT_SECTIONS])
def test_what_another_room_imports_documents_arguments_result_and_errors(
    room: str, classes: Classes, imported: set[tuple[str, str]]
) -> None:
    paths = [
        str(f.relative_to(ROOT)) for f in files_of(room) if str(f.parent.relative_to(ROOT)) not in WITHOUT_SECTIONS
    ]
    missing = []
    for path in paths:
        names = {name for place, name in imported if place == _room(path)}
        found = missing_sections((ROOT / path).read_text(), classes, names.__contains__)
        missing += [f"{path}: {what}" for what in found]
    assert missing == []
