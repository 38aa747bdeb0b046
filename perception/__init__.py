"""Perception: from an RGB-D frame to the 6D poses of the end effectors in it.

    from toolee_robot.perception import ToolPerception
    estimates = ToolPerception.load().estimate(frame)

`pipeline` joins the stages: `detection` (colour and depth to instance masks), `cloud` (mask and depth to points),
`pose` (points to pose, fusion over frames) and `trust` (the probability that a pose is right). `io` reads frames from
files, `dataset` and `synthesis` are the training data, `training` and `evaluation` what their names say.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if __name__ != "toolee_robot.perception":
    raise ImportError("import toolee_robot.perception: the short name would make a second copy of every module")

if TYPE_CHECKING:
    from toolee_robot.perception.detection.segmenter import Segmenter
    from toolee_robot.perception.pipeline import StageTimes, ToolPerception

__all__ = ["Segmenter", "StageTimes", "ToolPerception"]

_HOME = {"Segmenter": "detection.segmenter", "StageTimes": "pipeline", "ToolPerception": "pipeline"}


def __getattr__(name: str) -> Any:
    """Import a public name on first use.

    Training and data generation import this package without inference's libraries.
    """
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
