"""What the documents show can be typed: commands parse, imports resolve, reference tables are whole."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import re
from pathlib import Path

import pytest

from scripts.site_reference import PAGES, records
from tests.documents.blocks import DOCUMENTS, ROOT, blocks, commands
from toolee_robot.cli import app
from toolee_robot.errors import UserError
from toolee_robot.station import StationConfig
from toolee_robot.station.schema import field_docs


def exit_code(words: list[str]) -> int | str | None:
    """What the argument parser makes of `toolee WORDS`: 0 also where a command would begin."""
    try:
        app.parse(words)
    except SystemExit as end:
        return end.code
    except UserError:
        return app.EXIT_USER
    return 0


pytestmark = pytest.mark.sim(seconds=30)


def test_there_are_commands_to_check() -> None:
    assert len(list(commands())) > 40


@pytest.mark.parametrize(("path", "words"), [pytest.param(p, w, id=f"{p.stem}: {' '.join(w)}") for p, w in commands()])
def test_every_command_in_a_document_parses(path: Path, words: list[str]) -> None:
    assert exit_code(words) == 0, f"{path}: toolee {' '.join(words)}"


def test_a_command_with_an_unknown_option_does_not_parse() -> None:
    assert exit_code(["sim", "hammer", "--no-such-option"]) == 2


def test_every_import_in_a_document_resolves() -> None:
    count = 0
    for path, text in blocks("python"):
        for node in ast.walk(ast.parse(text if "--8<--" not in text else "")):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("toolee_robot"):
                module = importlib.import_module(str(node.module))
                for name in node.names:
                    assert hasattr(module, name.name), f"{path}: from {node.module} import {name.name}"
                    count += 1
    assert count > 5


def test_no_document_or_example_moves_an_arm_without_the_supervisor() -> None:
    shown = [*blocks("python"), *((path, path.read_text()) for path in (ROOT / "examples").glob("*.py"))]
    assert len(shown) > 5
    for path, text in shown:
        assert "UnsupervisedUrArm" not in text, f"{path} shows the driver alone: use stations.lab.open_arm"


def test_every_file_that_a_document_names_exists() -> None:
    rooms = r"(?:toolee_robot|perception|control|sim_backend|scripts|tests|examples|docs)/[\w/.-]+"
    for path in DOCUMENTS:
        if path.name == "CHANGELOG.md":
            continue
        for name in re.findall(rf"`({rooms})`", path.read_text()):
            assert (ROOT / name).exists(), f"{path.relative_to(ROOT)} names {name}"


def test_the_readme_is_one_screen() -> None:
    words = [word for word in (ROOT / "README.md").read_text().split() if any(map(str.isalnum, word))]
    assert len(words) <= 400


def test_every_field_of_the_station_file_has_a_description() -> None:
    for record in records(StationConfig):
        assert set(field_docs(record)) == {field.name for field in dataclasses.fields(record)}, record.__name__


def test_the_reference_names_every_topic_that_is_recorded() -> None:
    sources = " ".join(path.read_text() for path in (ROOT / "toolee_robot/recording").glob("*.py"))
    recorded = set(re.findall(r'"(/[a-z]+(?:/[a-z]+)*)"', sources))
    page = (ROOT / "docs/reference/recording.md").read_text()
    assert set(re.findall(r"`(/[a-z]+(?:/[a-z]+)*)`", page)) == recorded


def test_every_generated_page_is_generated() -> None:
    text = "".join(path.read_text() for path in DOCUMENTS)
    assert set(re.findall(r"^<!-- generated: ([a-z-]+) -->$", text, re.MULTILINE)) == set(PAGES)
    for name, write in PAGES.items():
        assert len(write().splitlines()) > 10, name
