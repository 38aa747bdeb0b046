"""Move a UR arm slowly, one confirmed motion at a time, under the supervisor: for its bring-up.

Example: toolee arm move --robot-host 127.0.0.2 --joint 1 --by 0.05

No joint turns faster than 0.1 rad/s, and hand and flange stay under supervisor.handover_speed.
"""

from __future__ import annotations

from toolee_robot.cli.arm.freedrive import Freedrive
from toolee_robot.cli.arm.home import Home
from toolee_robot.cli.arm.lag import Lag
from toolee_robot.cli.arm.move import Move
from toolee_robot.cli.arm.touch import Touch
from toolee_robot.cli.arm.transfer import Transfer

COMMANDS = {
    "move": Move,
    "home": Home,
    "transfer": Transfer,
    "touch": Touch,
    "lag": Lag,
    "freedrive": Freedrive,
}
