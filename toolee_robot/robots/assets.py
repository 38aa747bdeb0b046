"""Where the robots' model files are, and where the merged robot is cached."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

MODELS = Path(__file__).parent / "models"
"""Model files of arms and hands, a folder each, with their licences."""
UR10_URDF = MODELS / "ur10" / "ur10_robot.urdf"
SHADOW_HAND_MJCF = MODELS / "shadow_hand" / "robot.xml"


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
