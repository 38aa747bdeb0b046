"""The generative processes that a pose network may be trained for, by name."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from toolee_robot.perception.pose.edm import Edm
from toolee_robot.perception.pose.flow import Process, RectifiedFlow
from toolee_robot.perception.pose.variance_exploding import VarianceExploding

PROCESSES: Mapping[str, Process] = MappingProxyType(
    {"edm": Edm(), "flow": RectifiedFlow(), "score": VarianceExploding()}
)
"""EDM, flow matching, and the paper's score matching."""
