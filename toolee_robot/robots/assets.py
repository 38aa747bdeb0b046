"""Paths of the model files and of the cache of merged robots."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

MODELS = Path(__file__).parent / "models"
"""Model files and licences of arms and hands, one folder each."""
UR10_URDF = MODELS / "ur10" / "ur10_robot.urdf"
SHADOW_HAND_URDF = MODELS / "shadow_hand" / "shadow_hand.urdf"
INSPIRE_RH56_URDF = MODELS / "inspire_rh56" / "inspire_rh56.urdf"
ABILITY_HAND_URDF = MODELS / "ability_hand" / "ability_hand.urdf"


def cache_folder() -> Path:
    """The cache folder; it is created if it does not exist.

    Returns:
        $XDG_CACHE_HOME/toolee_robot or, if the variable is not set, ~/.cache/toolee_robot; a folder in the temporary
        directory if that is not writable.
    """
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
