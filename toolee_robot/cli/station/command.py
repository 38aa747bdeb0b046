"""Write, check, look at and upgrade the station file of a lab.

Example: toolee station new lab.yaml
"""

from __future__ import annotations

from toolee_robot.cli.station.check import Check
from toolee_robot.cli.station.new import New
from toolee_robot.cli.station.show import Show
from toolee_robot.cli.station.upgrade import Upgrade

COMMANDS = {
    "new": New,
    "check": Check,
    "show": Show,
    "upgrade": Upgrade,
}
