"""The page of a running job in the browser: the stage, what the person is to do, the nail, and the robot."""
# ruff: noqa: ARG002 - an observer receives more than it shows

from __future__ import annotations

from toolee_robot.config import StationConfig
from toolee_robot.control import RobotModel
from toolee_robot.frames import Array
from toolee_robot.hal import MotionReport
from toolee_robot.viewer.station_scene import StationPicture
from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.tasks.common.outcome import HammerResult, Stage, Strike
from toolee_robot.types import InHandEstimate

SHOWN = 6
"""Messages and strikes that are kept on the page."""
FACE = "hammer's face"
"""Name of its frame."""
_WORDS = {
    Stage.HANDOVER: "Handover: waiting for the hammer",
    Stage.GRIP: "Grip",
    Stage.VIEW: "Look: bringing the hammer before the camera",
    Stage.PERCEIVE: "Look: finding its face",
    Stage.PLAN: "Planning the strike",
    Stage.TOUCH: "Measuring the nail with a slow touch",
    Stage.STRIKE: "Striking: keep out of reach",
    Stage.PARK: "Parking",
}


class JobPage(TaskObserver):
    """Shows a job on a page of this computer; the robot at its last standstill.

    Args:
        config: What the station file says.
        port: Port of the page; the next free one is taken where it is in use.

    Raises:
        UserError: viser is not installed.
    """

    def __init__(self, config: StationConfig, port: int) -> None:
        self._picture = StationPicture(config, port)
        self._robot = RobotModel.of_station(config)
        self._protrusion = config.work.nail_protrusion
        self._X_hand_ee: Array | None = None
        self._stage, self._prompt, self._lines = "Connecting", "", list[str]()
        self._panel = self._picture.server.gui.add_markdown("")
        self._write()

    @property
    def address(self) -> str:
        """Address of the page."""
        return self._picture.address

    @property
    def text(self) -> str:
        """What the panel says, in Markdown."""
        return str(self._panel.content)

    def close(self) -> None:
        """Stop serving."""
        self._picture.close()

    def prompt(self, text: str) -> None:
        """Show what the person is to do; it stays until the job goes on.

        Args:
            text: The prompt.
        """
        self._prompt = text
        self._write()

    def stage_started(self, stage: Stage) -> None:
        self._stage, self._prompt = _WORDS[stage], ""
        self._write()

    def message(self, text: str) -> None:
        self._tell(text)

    def in_hand(self, stamp: float, estimate: InHandEstimate) -> None:
        if estimate.usable:
            self._X_hand_ee = estimate.X_hand_ee

    def motion(self, name: str, report: MotionReport, hand_joints: Array) -> None:
        self._prompt = ""
        if len(report.q_commanded):
            q = report.q_commanded[-1]
            self._picture.move_robot(q, hand_joints)
            if self._X_hand_ee is not None:
                self._picture.frame(FACE, self._robot.X_base_ee(q, hand_joints, self._X_hand_ee))
        self._write()

    def strike(self, strike: Strike) -> None:
        if strike.protrusion is not None:
            self._protrusion = strike.protrusion
        left = "not measured" if strike.protrusion is None else f"{strike.protrusion * 1e3:.1f} mm left"
        self._tell(f"strike {strike.number}: {left}, {strike.peak_force:.0f} N")

    def ended(self, result: HammerResult) -> None:
        self._stage, self._prompt = str(result.outcome).replace("_", " ").capitalize(), ""
        self._tell(result.reason)

    def _tell(self, line: str) -> None:
        self._lines = [*self._lines, line][-SHOWN:]
        self._write()

    def _write(self) -> None:
        parts = [f"## {self._stage}"]
        if self._prompt:
            parts.append(f"### ➤ {self._prompt}")
        parts.append(f"**Nail**: {self._protrusion * 1e3:.1f} mm over the wood")
        parts += [f"- {line}" for line in self._lines]
        self._panel.content = "\n\n".join(parts)
