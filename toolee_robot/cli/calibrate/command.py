"""Calibrate a station: where the camera stands, and where tip and nail are, seen from the robot.

Example: toolee calibrate board --sheet a3 --out board.pdf

Example: toolee calibrate camera
"""

from __future__ import annotations

from toolee_robot.cli.calibrate.board import PrintBoard
from toolee_robot.cli.calibrate.camera import Camera
from toolee_robot.cli.calibrate.check import Check
from toolee_robot.cli.calibrate.intrinsics import Intrinsics
from toolee_robot.cli.calibrate.mount import Mount
from toolee_robot.cli.calibrate.nail import Nail

COMMANDS = {
    "board": PrintBoard,
    "camera": Camera,
    "check": Check,
    "intrinsics": Intrinsics,
    "mount": Mount,
    "nail": Nail,
}
