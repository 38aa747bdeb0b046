"""Find, show, record and check an RGB-D camera.

Example: toolee camera list
"""

from __future__ import annotations

from toolee_robot.cli.camera.check import CheckCamera
from toolee_robot.cli.camera.list_cameras import ListCameras
from toolee_robot.cli.camera.record import Record
from toolee_robot.cli.camera.show import Show

COMMANDS = {
    "list": ListCameras,
    "show": Show,
    "record": Record,
    "doctor": CheckCamera,
}
