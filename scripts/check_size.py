"""Code lines of each room against `size_budget.toml`: lines without docstrings, comments and blanks. For CI.

    python scripts/check_size.py             # exit code 1: a room, the files or the tests are over their budget
    python scripts/check_size.py --report    # every room, and the largest functions

A room is a folder that the budget names; what lies in no such folder counts for the one above it. To let a room grow,
edit its budget and give the reason in the commit.
"""

from __future__ import annotations

import argparse
import ast
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
BUDGET = ROOT / "size_budget.toml"
PRODUCT = ("toolee_robot", "perception", "control", "sim_backend")
MAX_COMPLEXITY, MAX_LINES, REPORTED = 12, 50, 25
"""Above which a function is reported, and how many are."""
_BRANCHES = (ast.If, ast.IfExp, ast.For, ast.AsyncFor, ast.While, ast.ExceptHandler, ast.comprehension, ast.match_case)


def python_files(*folders: str) -> list[Path]:
    """The files of these folders of the repository; a folder that is a link to another is not followed."""
    paths = (path for folder in folders for path in (ROOT / folder).rglob("*.py"))
    return sorted(path for path in paths if not any(parent.is_symlink() for parent in path.parents))


def code_lines(source: str) -> int:
    """Number of lines without docstrings, comments and blanks."""
    documented: set[int] = set()
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Expr(value=ast.Constant(value=str())):
                documented.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    lines = enumerate(source.splitlines(), 1)
    return sum(1 for n, line in lines if line.strip() and not line.strip().startswith("#") and n not in documented)


def sizes(rooms: list[str]) -> Counter[str]:
    """Code lines of each room, and of the whole product, its files and all lines of the tests."""
    counts: Counter[str] = Counter(dict.fromkeys(rooms, 0))
    for path in python_files(*PRODUCT):
        lines, folders = code_lines(path.read_text()), path.relative_to(ROOT).parents
        counts[next((str(folder) for folder in folders if str(folder) in rooms), "no room")] += lines
        counts["product"] += lines
        counts["files"] += 1
    counts["tests"] = sum(len(path.read_text().splitlines()) for path in python_files("tests"))
    return counts


def complexity(function: ast.AST) -> int:
    """McCabe's number of ways through a function."""
    nodes = list(ast.walk(function))
    conditions = sum(len(node.values) - 1 for node in nodes if isinstance(node, ast.BoolOp))
    return 1 + conditions + sum(isinstance(node, _BRANCHES) for node in nodes)


def large_functions() -> Iterator[tuple[int, int, str]]:
    """Yield complexity, lines and place of every function that is over what is wanted."""
    for path in python_files(*PRODUCT):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                ways, lines = complexity(node), (node.end_lineno or node.lineno) - node.lineno + 1
                if ways > MAX_COMPLEXITY or lines > MAX_LINES:
                    yield ways, lines, f"{path.relative_to(ROOT)}:{node.lineno} {node.name}"


def main(arguments: list[str] | None = None) -> int:
    """Compare, print, and return the exit code."""
    parser = argparse.ArgumentParser(description="Compare the size of each room with its budget.")
    parser.add_argument("--report", action="store_true", help="print every room, and the largest functions")
    report = parser.parse_args(arguments).report
    budget: dict[str, int] = {}
    for table in tomllib.loads(BUDGET.read_text()).values():
        budget |= table
    counts = sizes(list(budget))
    over = [name for name, count in counts.items() if count > budget.get(name, 0)]
    for name, count in sorted(counts.items()):
        if report or name in over:
            print(f"{name}: {count} of {budget.get(name, 0)}{', OVER its budget' if name in over else ''}")
    large = sorted(large_functions(), reverse=True)
    print(f"{len(large)} functions over complexity {MAX_COMPLEXITY} or {MAX_LINES} lines")
    for ways, lines, place in large[:REPORTED] if report else []:
        print(f"  complexity {ways}, {lines} lines: {place}")
    if not over:
        print(f"size ok: {counts['product']} code lines in {counts['files']} files, tests {counts['tests']} lines")
    return int(bool(over))


if __name__ == "__main__":
    sys.exit(main())
