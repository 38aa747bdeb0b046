"""Robots in the cache: URDF and meshes, in folders named by their content.

Robots that differ in their calibration share the meshes.
"""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

from toolee_robot.robots.assets import cache_folder
from toolee_robot.robots.tree import Tree
from toolee_robot.robots.urdf import write_urdf


def install_urdf(name: str, tree: Tree) -> Path:
    """Write a robot's URDF and meshes into the cache, unless they are there.

    Args:
        name: Name of the robot and of the file.
        tree: Its links.

    Returns:
        The URDF's path.
    """
    text = write_urdf(name, tree, _install_meshes(tree).__getitem__)
    folder = cache_folder() / f"robot-{hashlib.sha256(text.encode()).hexdigest()[:16]}"

    def write(scratch: Path) -> None:
        (scratch / f"{name}.urdf").write_text(text)

    _install_folder(folder, write)
    return folder / f"{name}.urdf"


def _install_meshes(tree: Tree) -> dict[Path, Path]:
    """Copy the meshes of a robot into the cache and return where each one lies."""
    owners = {shape.mesh: link for link in tree.links for shape in (*link.visuals, *link.collisions) if shape.mesh}
    names = {file: f"{link.name}_{file.name}" for file, link in owners.items()}
    probe = hashlib.sha256()
    for file, name in names.items():
        probe.update(name.encode() + file.read_bytes())
    folder = cache_folder() / f"meshes-{probe.hexdigest()[:16]}"

    def copy(scratch: Path) -> None:
        for file, name in names.items():
            shutil.copyfile(file, scratch / name)

    _install_folder(folder, copy)
    return {file: folder / name for file, name in names.items()}


def _install_folder(folder: Path, fill: Callable[[Path], None]) -> None:
    """Make a folder of the cache, whole or not at all, unless it is there."""
    if folder.is_dir():
        return
    scratch = Path(tempfile.mkdtemp(dir=folder.parent))
    try:
        fill(scratch)
        scratch.replace(folder)
    except OSError:  # another process installed it meanwhile
        shutil.rmtree(scratch, ignore_errors=True)
        if not folder.is_dir():
            raise
