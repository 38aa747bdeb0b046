"""Check of the networks' weights."""

from __future__ import annotations

import time
from pathlib import Path

from toolee_robot.errors import AssetError
from toolee_robot.findings import Finding, ok
from toolee_robot.perception import ToolPerception


def check_weights(folder: Path | None = None) -> Finding:
    """Check that the weights can be loaded.

    Args:
        folder: Folder of the weights; None for the shipped ones.
    """
    began = time.perf_counter()
    try:
        ToolPerception.load(folder)
    except AssetError as error:
        return Finding.of_error("networks", error, "reinstall the package")
    return ok("networks", f"loaded in {time.perf_counter() - began:.1f} s")
