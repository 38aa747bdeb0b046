"""Where the model packages keep their files, and where ours are cached."""

from __future__ import annotations

import importlib.util
import os
import tempfile
from importlib import metadata
from pathlib import Path

from toolee_robot.errors import AssetError


def ur10_urdf() -> Path:
    """The UR10's URDF in `example-robot-data`. Raises AssetError naming the package."""
    try:
        files = metadata.files("example-robot-data") or []
    except metadata.PackageNotFoundError as error:
        raise AssetError("the UR10 model is missing: pip install example-robot-data") from error
    for file in files:
        if file.name == "ur10_robot.urdf":
            path = Path(str(file.locate()))
            if path.is_file():
                return path
    raise AssetError("ur10_robot.urdf is not in example-robot-data: pip install --force-reinstall example-robot-data")


def shadow_hand_folder() -> Path:
    """Folder `envs/assets` of `gymnasium-robotics`, found without importing the package. Raises AssetError."""
    spec = importlib.util.find_spec("gymnasium_robotics")
    for location in (spec.submodule_search_locations or []) if spec is not None else []:
        folder = Path(location) / "envs" / "assets"
        if (folder / "hand" / "robot.xml").is_file() and (folder / "stls" / "hand" / "palm.stl").is_file():
            return folder
    raise AssetError("the Shadow Hand model is missing: pip install gymnasium-robotics")


def model_versions() -> str:
    """Versions of the two model packages, as part of the cache's key. Raises AssetError naming a missing one."""
    versions = []
    for package in ("example-robot-data", "gymnasium-robotics"):
        try:
            versions.append(metadata.version(package))
        except metadata.PackageNotFoundError as error:
            raise AssetError(f"the robot model is missing: pip install {package}") from error
    return "-".join(versions)


def cache_folder() -> Path:
    """$XDG_CACHE_HOME/toolee_robot, ~/.cache/toolee_robot, or a folder in the temporary directory if neither can be
    written."""
    base = os.environ.get("XDG_CACHE_HOME")
    folder = (Path(base) if base else Path.home() / ".cache") / "toolee_robot"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError:
        folder = Path(tempfile.gettempdir()) / f"toolee_robot-{os.getuid() if hasattr(os, 'getuid') else 'user'}"
        folder.mkdir(parents=True, exist_ok=True)
        return folder
