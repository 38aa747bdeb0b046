"""The generative processes that a pose network may be trained for, by name."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from toolee_robot.perception.pose.processes.edm import Edm
from toolee_robot.perception.pose.processes.flow import Process, RectifiedFlow
from toolee_robot.perception.pose.processes.variance_exploding import VarianceExploding

PROCESSES: Mapping[str, Process] = MappingProxyType(
    {"edm": Edm(), "flow": RectifiedFlow(), "score": VarianceExploding()}
)
"""EDM, flow matching, and the paper's score matching."""
