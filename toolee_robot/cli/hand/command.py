"""Read, open or close the hand of a station file, or clear its faults, without a job.

The arm is neither asked nor moved.

Example: toolee hand state --station lab.yaml
"""

from __future__ import annotations

from toolee_robot.cli.hand.clear_faults import ClearFaults
from toolee_robot.cli.hand.close import Close
from toolee_robot.cli.hand.efforts import Efforts
from toolee_robot.cli.hand.open import Open
from toolee_robot.cli.hand.state import State

COMMANDS = {
    "state": State,
    "open": Open,
    "close": Close,
    "clear-faults": ClearFaults,
    "efforts": Efforts,
}
