"""`toolee arm home`: to the station's home posture."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from toolee_robot.cli.arm.options import MotionOptions
from toolee_robot.cli.arm.transfer import Transfer


@dataclass(frozen=True, kw_only=True)
class Home(MotionOptions):
    """Move to scene.home on a way that is checked for collisions, once a person has confirmed it.

    Example: toolee arm home --robot-host 192.168.1.10 --config lab.yaml
    """

    def run(self) -> int:
        return Transfer(to="home", **asdict(self)).run()
