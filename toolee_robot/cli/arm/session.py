"""One `toolee arm` command: the arm under the supervisor, its plans shown, confirmed and executed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

import numpy as np
from rich.console import Console
from rich.table import Table

from toolee_robot.cli.arm.options import ArmOptions, MotionOptions
from toolee_robot.cli.arm.terminal import TerminalPerson
from toolee_robot.cli.output import json_line
from toolee_robot.control import Supervisor
from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array, BaseFrame, inverse
from toolee_robot.hal import MotionOutcome
from toolee_robot.stations.ur import open_arm
from toolee_robot.tasks.bring_up.caps import Caps, SlowStation
from toolee_robot.types import Trajectory

JOINTS = ("base", "shoulder", "elbow", "wrist 1", "wrist 2", "wrist 3")
SEEN = 5e-4
"""Speed below which a joint is not listed [rad/s]."""


@dataclass(frozen=True)
class Session:
    """A robot at a person's disposal.

    Attributes:
        arm: The arm, under the supervisor.
        slow: The station under its caps.
        person: The person at the terminal.
        console: The console.
    """

    arm: Supervisor
    slow: SlowStation
    person: TerminalPerson
    console: Console

    @property
    def q(self) -> Array:
        """Joint positions that the arm holds, (6,) [rad]."""
        return self.arm.state().q_commanded

    def show(self, what: str, trajectory: Trajectory) -> None:
        """Tell what will move, how far and how fast.

        Args:
            what: Name of the motion.
            trajectory: The motion.
        """
        self.console.print(f"[bold]{what}[/bold]")
        self.console.print(motion_table(trajectory))
        self.console.print(path_text(self.slow, trajectory), soft_wrap=True)

    def move(self, what: str, trajectory: Trajectory) -> dict[str, object]:
        """Show a motion, ask for it, execute it, and tell where the arm is.

        Args:
            what: Name of the motion.
            trajectory: The motion, from rest to rest.

        Returns:
            Figures for --json.

        Raises:
            PersonNearError: It was not confirmed, or a key was pressed.
            DeviceError: The arm was stopped.
            TooleeError: What `Supervisor.execute` raises.
        """
        self.show(what, trajectory)
        self.person.confirm("Move?")
        with self.person.attending():
            report = self.arm.execute(trajectory)
        if report.outcome is not MotionOutcome.COMPLETED:
            raise DeviceError(f"the arm was stopped during the motion {what!r}", code="device.stopped")
        q = report.q_measured[-1]
        X = self.slow.robot.arm.fk(q)
        self.console.print(f"Done. Flange: {place_text(X)}", soft_wrap=True)
        return {"q": q.tolist(), "duration": trajectory.duration, **place_figures(X)}


@contextmanager
def session(options: ArmOptions, console: Console) -> Iterator[Session]:
    """Check the robot and connect, which moves nothing; leaving the context ends its program.

    Args:
        options: Where the robot is, and how fast it may move.
        console: The console.

    Yields:
        The session.

    Raises:
        TooleeError: The options do not fit, or the robot is not ready.
    """
    caps = Caps(options.max_speed, options.max_acceleration) if isinstance(options, MotionOptions) else Caps()
    config, host = options.load()
    slow = SlowStation.of(config, caps)
    person = TerminalPerson(console, absent=options.yes)
    stack = ExitStack()
    with console.status(f"asking the robot at {host}"):
        arm = open_arm(slow.config, host, person)
        stack.enter_context(arm)
    with stack:
        yield Session(arm, slow, person, console)


def run_motion(options: MotionOptions, what: str, plan: Callable[[SlowStation, Array], Trajectory]) -> int:
    """Plan one motion and execute it, once a person has confirmed it.

    Args:
        options: Where the robot is, and how fast it may move.
        what: Name of the motion.
        plan: Plans it from the present joint positions, (6,) [rad].

    Returns:
        The exit code.

    Raises:
        TooleeError: The options do not fit, the robot is not ready, or the motion was refused or stopped.
    """
    console = Console(stderr=options.json, highlight=False)
    with session(options, console) as robot:
        with console.status("planning"):
            trajectory = plan(robot.slow, robot.q)
        figures = robot.move(what, trajectory)
    if options.json:
        print(json_line(figures), flush=True)
    return 0


def motion_table(trajectory: Trajectory) -> Table:
    """Format a motion: what turns from where to where, and how fast."""
    table = Table(box=None, padding=(0, 2, 0, 0))
    for column in ("joint", "from, rad", "to, rad", "by, rad", "at most, rad/s"):
        table.add_column(column, justify="left" if column == "joint" else "right")
    first, last, fastest = trajectory.q[0], trajectory.q[-1], np.max(np.abs(trajectory.qd), axis=0)
    for i, name in enumerate(JOINTS):
        if fastest[i] > SEEN:
            values = (f"{first[i]:.4f}", f"{last[i]:.4f}", f"{last[i] - first[i]:+.4f}", f"{fastest[i]:.3f}")
            table.add_row(f"{i + 1} {name}", *values)
    return table


def path_text(slow: SlowStation, trajectory: Trajectory) -> str:
    """Format the way of the flange, in both frames of the base, and the duration.

    Args:
        slow: The station under its caps.
        trajectory: The motion.

    Returns:
        Three lines.
    """
    Xs = slow.robot.arm.fk(trajectory.q)
    moved = np.linalg.norm(np.diff(Xs[:, :3, 3], axis=0), axis=1)
    speed = float(np.max(moved / np.diff(trajectory.times)))
    arm = slow.config.arm
    return (
        f"flange from: {place_text(Xs[0])}\nflange to:   {place_text(Xs[-1])}\n"
        f"over {float(np.sum(moved)) * 1e3:.0f} mm in {trajectory.duration:.1f} s, at {speed:.3f} m/s at most "
        f"(caps: {max(arm.velocity):g} rad/s, {arm.acceleration:g} rad/s²)"
    )


def place_text(X_base_flange: Array) -> str:
    """Format a flange's position in both frames of the base [mm]."""
    return ", ".join(f"{frame} ({_mm(place)})" for frame, place in _places(X_base_flange))


def place_figures(X_base_flange: Array) -> dict[str, object]:
    """A flange's position in both frames of the base [m], for --json."""
    return {f"flange_{frame}": place.tolist() for frame, place in _places(X_base_flange)}


def _places(X_base_flange: Array) -> Iterator[tuple[BaseFrame, Array]]:
    for frame in (BaseFrame.PENDANT_BASE, BaseFrame.BASE_LINK):
        yield frame, (inverse(frame.X_base_this) @ X_base_flange)[:3, 3]


def _mm(place: Array) -> str:
    return ", ".join(f"{1e3 * value:.1f}" for value in place) + " mm"
