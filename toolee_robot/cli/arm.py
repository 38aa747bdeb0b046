"""Move a UR arm under the supervisor, each motion confirmed by a person: for its bring-up.

Example: toolee arm move --robot-host 127.0.0.2 --joint 1 --by 0.05

No joint turns faster than 0.1 rad/s, and hand and flange stay under supervisor.handover_speed. `acceleration` is fast.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import tyro
from rich.console import Console
from rich.live import Live
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from toolee_robot.arm_data import JOINTS
from toolee_robot.cli.output import STATION, Flag, JsonOption, TerminalPerson
from toolee_robot.errors import UserError
from toolee_robot.runtime.clock import is_loopback

if TYPE_CHECKING:
    from toolee_robot.app.bring_up import BringUp
    from toolee_robot.frames import Array
    from toolee_robot.station import StationConfig
    from toolee_robot.tasks.bring_up.acceleration import AccelerationTrial
    from toolee_robot.tasks.bring_up.lag import Trial
    from toolee_robot.tasks.bring_up.slow_motions import Caps, SlowStation
    from toolee_robot.types import Trajectory

_SEEN = 5e-4
"""Speed below which a joint is not listed [rad/s]."""
_PERIOD = 0.1
"""Time between two readings of the joints [s]."""
_LAG_HEADER = " gain lookahead    speed     lag amplitude overshoot   noise vibration ratio"
_LAG_UNITS = "            [s]  [rad/s]    [ms]                 [%]  [mrad]    [mrad]"

Frame = Literal["pendant_base", "base_link", "tool"]


@dataclass(frozen=True, kw_only=True)
class ArmOptions(JsonOption):
    """Where the robot is, and what station it belongs to."""

    robot_host: Annotated[
        str | None, tyro.conf.arg(metavar="ADDRESS", help_behavior_hint="(default: arm.host of the station file)")
    ] = None
    """Address of the UR controller: a robot's, or the loopback address of `toolee emulate ur`."""
    config: Annotated[Path | None, STATION] = None
    """The station file, which sets the limits. An emulated robot does not need it."""
    yes: Flag = False
    """Do not ask, and ignore keys: for scripts, and only with an emulated robot on a loopback address."""

    def load(self) -> tuple[StationConfig, str]:
        """The station, and the address of its controller."""
        from toolee_robot.station import load_lab_station, load_station, sim_station

        station = sim_station() if self.config is None else load_station(self.config)
        host = self.robot_host or station.arm.host
        if host is None:
            raise UserError("no robot: give --station with a station file that names arm.host, or --robot-host")
        if is_loopback(host):
            return station, host
        if self.yes:
            raise UserError(f"leave --yes out: {host} may be a real robot, and a person confirms its motions")
        if self.config is None:
            raise UserError(f"--robot-host {host} also needs --station, the station file of the robot")
        return load_lab_station(self.config), host

    def caps(self) -> Caps:
        """How fast the arm may move."""
        from toolee_robot.tasks.bring_up.slow_motions import Caps

        return Caps()

    @contextmanager
    def robot(self, console: Console) -> Iterator[BringUp]:
        """Context with the robot, connected; nothing moves."""
        from toolee_robot.app.bring_up import open_bring_up

        station, host = self.load()
        person = TerminalPerson(console, absent=self.yes)
        console.print(f"[dim]asking the robot at {host}[/dim]")
        with open_bring_up(station, host, person, self.caps()) as robot:
            yield robot


@dataclass(frozen=True, kw_only=True)
class MotionOptions(ArmOptions):
    """How fast a motion may be."""

    max_speed: Annotated[float, tyro.conf.arg(metavar="RAD/S")] = 0.1
    """Speed limit of every joint. Begin slowly; the station file's limits also apply."""
    max_acceleration: Annotated[float, tyro.conf.arg(metavar="RAD/S2")] = 1.0
    """Acceleration limit of every joint. The station file's limits also apply."""

    def caps(self) -> Caps:
        """See `ArmOptions`."""
        from toolee_robot.tasks.bring_up.slow_motions import Caps

        return Caps(self.max_speed, self.max_acceleration)

    def move(self, what: str, plan: Callable[[BringUp], Trajectory]) -> int:
        """Plan one motion, show it, and execute it once a person has confirmed it."""
        console = self.console
        with self.robot(console) as robot:
            with console.status("planning"):
                trajectory = plan(robot)
            _show(console, robot.slow, what, trajectory)
            q = robot.move(trajectory)
            X_base_flange = robot.slow.robot.arm.fk(q)
        console.print(f"Done. Flange: {_place_text(X_base_flange)}", soft_wrap=True)
        self.tell({"q": q.tolist(), "duration": trajectory.duration, **_place_figures(X_base_flange)})
        return 0


@dataclass(frozen=True, kw_only=True)
class Move(MotionOptions):
    """Turn joints, or move the flange along a straight line.

    Example: toolee arm move --robot-host 192.168.1.10 --station lab.yaml --joint 3 --by 0.05

    Example: toolee arm move --robot-host 127.0.0.2 --along 0 0 0.05 --frame pendant_base

    A person confirms the motion first. The motion does not avoid obstacles: it is refused if something is in the way.
    Any key stops the arm on its path, and so does Ctrl-C.
    """

    joint: Annotated[int | None, tyro.conf.arg(metavar="1..6", help_behavior_hint="")] = None
    """Joint to turn: 1 base, 2 shoulder, 3 elbow, 4 to 6 wrists."""
    by: Annotated[float | None, tyro.conf.arg(metavar="RAD", help_behavior_hint="")] = None
    """Angle to turn, with --joint."""
    to: Annotated[
        tuple[float, float, float, float, float, float] | None,
        tyro.conf.arg(metavar="RAD RAD RAD RAD RAD RAD", help_behavior_hint=""),
    ] = None
    """Joint positions to move to, base to wrist 3."""
    along: Annotated[tuple[float, float, float] | None, tyro.conf.arg(metavar="X Y Z", help_behavior_hint="")] = None
    """Displacement of the flange [m], with --frame."""
    frame: Annotated[Frame | None, tyro.conf.arg(metavar="pendant_base|base_link|tool", help_behavior_hint="")] = None
    """Frame of --along: the pendant's Base, ROS's base_link (turned by half a turn about z), or the flange's axes."""

    def run(self) -> int:
        jog = self.joint is not None and self.by is not None
        if (self.joint is None) != (self.by is None) or (self.along is None) != (self.frame is None):
            raise UserError("give --joint together with --by, and --along together with --frame")
        if jog + (self.to is not None) + (self.along is not None) != 1:
            raise UserError("give one motion: --joint with --by, --to, or --along with --frame")
        return self.move("move", self._plan)

    def _plan(self, robot: BringUp) -> Trajectory:
        from toolee_robot.tasks.bring_up.slow_motions import MotionFrame, jog_joint, plan_joints, plan_line

        if self.along is not None and self.frame is not None:
            return plan_line(robot.slow, robot.q, np.array(self.along), MotionFrame(self.frame))
        if self.joint is not None and self.by is not None:
            return plan_joints(robot.slow, robot.q, jog_joint(robot.q, self.joint, self.by))
        return plan_joints(robot.slow, robot.q, np.array(self.to))


@dataclass(frozen=True, kw_only=True)
class Transfer(MotionOptions):
    """Move to a place of the station, around what is in the way.

    Example: toolee arm transfer --robot-host 192.168.1.10 --station lab.yaml --to handover

    A person confirms the motion first. The hand is open and empty. Any key stops the arm on its path, and so does
    Ctrl-C.
    """

    to: Literal["home", "handover", "view", "nail"]
    """handover: where a person hands a tool over; view: where the camera sees the tool; nail: above the nail, where
    a strike begins; home: scene.home.
    """
    view: Annotated[int, tyro.conf.arg(metavar="N")] = 1
    """Which view, with --to view."""

    def run(self) -> int:
        return self.move(f"to {self.to}", self._plan)

    def _plan(self, robot: BringUp) -> Trajectory:
        from toolee_robot.tasks.bring_up.slow_motions import Place, plan_to_place

        return plan_to_place(robot.slow, robot.q, Place(self.to), self.view)


@dataclass(frozen=True, kw_only=True)
class Touch(MotionOptions):
    """Move straight on until the arm feels a force, and back.

    Example: toolee arm touch --robot-host 192.168.1.10 --station lab.yaml --along 0 0 -0.1 --frame pendant_base

    Touch something soft, such as a block of foam. It must not be in the station file, or the motion is
    refused. Any key stops the arm on its path, and so does Ctrl-C. Exit code 1: no contact.
    """

    along: Annotated[tuple[float, float, float], tyro.conf.arg(metavar="X Y Z")]
    """Longest displacement of the flange [m]."""
    frame: Frame
    """Frame of --along: the pendant's Base, ROS's base_link (turned by half a turn about z), or the flange's axes."""
    force: Annotated[float | None, tyro.conf.arg(metavar="N", help_behavior_hint="")] = None
    """Force that ends the approach (default: strike.touch_force). If the force is noisy, it is raised by half at
    most.
    """
    speed: Annotated[float, tyro.conf.arg(metavar="M/S")] = 0.01
    """Speed of the approach. If the force is noisy, it is lowered."""

    def run(self) -> int:
        console = self.console
        from toolee_robot.tasks.bring_up.slow_motions import MotionFrame

        with self.robot(console) as robot:

            def show(plan: Trajectory, force: float, speed: float) -> None:
                slower = "" if speed == self.speed else " because the force is noisy"
                what = f"touch: approach at {1e3 * speed:.1f} mm/s until {force:.1f} N{slower}, then go back"
                _show(console, robot.slow, what, plan)

            way, frame = np.array(self.along), MotionFrame(self.frame)
            touch = robot.touch(way, frame, self.speed, self.force, show)
        if touch is None:
            console.print("[yellow]No contact within the given distance.[/yellow] The arm is back at its start.")
            self.tell({"contact": False})
            return 1
        where = _place_text(touch.X_base_flange)
        told = f"Contact after {touch.travelled * 1e3:.1f} mm, {touch.force:.1f} N at rest. Flange: {where}"
        console.print(told, soft_wrap=True)
        places = _place_figures(touch.X_base_flange)
        figures = {"contact": True, "travelled": touch.travelled, "force": touch.force, "q": touch.q.tolist()}
        self.tell({**figures, **places})
        return 0


@dataclass(frozen=True, kw_only=True)
class Lag(MotionOptions):
    """Measure the servo's lag, and recommend its settings.

    Example: toolee arm lag --robot-host 192.168.1.10 --station lab.yaml --joint 1 --write

    One joint moves in sines and steps of rising speed, first with gentle settings, then with sharper ones. The command
    ends at the first sign of vibration. Listen to the arm, and press a key if it hums. Exit code 1: even the gentlest
    settings vibrate or overshoot.
    """

    joint: Annotated[int, tyro.conf.arg(metavar="1..6")] = 1
    """Joint that moves: 1 base, 2 shoulder, 3 elbow, 4 to 6 wrists."""
    write: Flag = False
    """Write the recommended gain, lookahead and lag into `measured.yaml` beside the station file."""

    def run(self) -> int:
        if self.write and self.config is None:
            raise UserError("--write needs --station: the station file to write to")
        console = self.console
        station, host = self.load()
        from toolee_robot.app.bring_up import tune_servo
        from toolee_robot.tasks.bring_up.lag import PAIRS, SHARES, recommend

        def show(robot: BringUp, largest: Trajectory, reach: float) -> None:
            _show(console, robot.slow, f"lag of joint {self.joint}, up to {len(PAIRS) * len(SHARES)} motions", largest)
            console.print(f"by at most {reach:.3f} rad to each side of its present position")

        person = TerminalPerson(console, absent=self.yes)
        trials: list[Trial] = []
        for trial in tune_servo(station, host, person, self.caps(), self.joint, show):
            if not trials:
                console.print(f"{_LAG_HEADER}\n{_LAG_UNITS}", markup=False, soft_wrap=True)
            trials.append(trial)
            console.print(_lag_row(trial), soft_wrap=True)
        best = recommend(trials)
        if best is None:
            console.print("[red]Even the gentlest settings vibrate or overshoot.[/red] Check payload, mount and load.")
        else:
            words = f"gain {best.gain:g}, lookahead {best.lookahead:g} s, lag {best.lag:g} s"
            fastest = max(trial.figures.speed for trial in trials)
            console.print(f"[bold]Recommended: {words}[/bold]. Measured at up to {fastest:.3g} rad/s.", soft_wrap=True)
        if best is not None and self.write and self.config is not None:
            from toolee_robot.station import write_measured

            file = write_measured(self.config, servo=asdict(best))
            console.print(f"Written to {file}.")
        told = [{"gain": t.gain, "lookahead": t.lookahead, **asdict(t.figures)} for t in trials]
        self.tell({"trials": told, "recommended": None if best is None else asdict(best)})
        return int(best is None)


@dataclass(frozen=True, kw_only=True)
class Freedrive(ArmOptions):
    """Let a person move the arm by hand, and show where it is.

    Example: toolee arm freedrive --robot-host 192.168.1.10 --station lab.yaml

    Any key ends it, and the arm then holds its position. With a wrong payload the arm sinks or rises when you let go.
    """

    seconds: Annotated[float | None, tyro.conf.arg(metavar="S", help_behavior_hint="")] = None
    """End after this time."""

    def run(self) -> int:
        if self.yes and self.seconds is None:
            raise UserError("--yes needs --seconds, because nobody is there to end it")
        console = self.console
        with self.robot(console) as robot:
            fk = robot.slow.robot.arm.fk
            robot.person.confirm("Freedrive: hold the arm. With a wrong payload it sinks or rises. Begin?")
            end = np.inf if self.seconds is None else time.monotonic() + self.seconds
            with robot.person.attending(), robot.arm.freedrive(), Live(console=console, auto_refresh=False) as live:
                while robot.person.hold_to_run_held() and time.monotonic() < end:
                    q = robot.arm.state().joints.q
                    joints = "  ".join(f"{value:8.4f}" for value in q)
                    live.update(Text(f"joints, rad {joints}\nflange {_place_text(fk(q))}"), refresh=True)
                    time.sleep(_PERIOD)
            q = robot.q
        console.print("\nThe arm holds its position.")
        self.tell({"q": q.tolist(), **_place_figures(fk(q))})
        return 0


@dataclass(frozen=True, kw_only=True)
class Acceleration(ArmOptions):
    """Find the acceleration that each joint bears.

    Example: toolee arm acceleration --station lab.yaml --most 8

    Enter the result as arm.acceleration in the station file. The motions are fast: keep everybody out of reach.

    One joint after the other turns about its present place, first gently, then faster. A joint's test ends at
    the first of these: half of the way to a protective stop or to supervisor.tracking_error, vibration, a stop, a limit
    of the station.
    Mount the hand or the mount, and leave it empty. A person shows that door and switch work, confirms once, and stays
    outside.
    An opened door stops the arm. Nothing is written. Exit code 1: a joint bears less than 2 rad/s², or was not tried.
    """

    joint: Annotated[tuple[int, ...], tyro.conf.arg(metavar="1..6")] = (1, 2, 3, 4, 5, 6)
    """Joints that move, in this order: 1 base, 2 shoulder, 3 elbow, 4 to 6 wrists."""
    most: Annotated[
        float | None, tyro.conf.arg(metavar="RAD/S2", help_behavior_hint="(default: the largest in arm.acceleration)")
    ] = None
    """Largest acceleration that is tried, 2 to 40."""

    def run(self) -> int:
        console = self.console
        station, host = self.load()
        from toolee_robot.app.bring_up import try_accelerations
        from toolee_robot.tasks.bring_up.acceleration import borne

        most = max(station.arm.acceleration) if self.most is None else self.most

        def show(slow: SlowStation, largest: Sequence[Trajectory]) -> None:
            for joint, trajectory in zip(self.joint, largest, strict=True):
                _show(console, slow, f"joint {joint}, up to {most:g} rad/s²", trajectory)

        person = TerminalPerson(console, absent=True) if self.yes else None
        trials: list[AccelerationTrial] = []
        for trial in try_accelerations(station, host, self.joint, most, show, console.print, person):
            trials.append(trial)
            console.print(_acceleration_row(trial), soft_wrap=True)
        found = borne(trials)
        missing = [joint for joint in self.joint if joint not in found]
        line = [found.get(i, value) for i, value in enumerate(station.arm.acceleration, start=1)]
        if missing:
            joints = ", ".join(map(str, missing))
            console.print(
                f"[red]No acceleration was found for joint {joints}.[/red] Make the robot ready, try it alone."
            )
        else:
            console.print(
                f"[bold]Recommended, for `arm` in {self.config or 'the station file'}:[/bold]", soft_wrap=True
            )
            console.print(f"  acceleration: {[round(a, 3) for a in line]}", markup=False, soft_wrap=True)
        told = [asdict(trial) for trial in trials]
        self.tell({"trials": told, "recommended": None if missing else line})
        return int(bool(missing))


_MOTIONS = {"move": Move, "transfer": Transfer, "touch": Touch}
COMMANDS = {"arm": {**_MOTIONS, "lag": Lag, "acceleration": Acceleration, "freedrive": Freedrive}}


def _show(console: Console, slow: SlowStation, what: str, trajectory: Trajectory) -> None:
    """Tell what will move, how far and how fast: joints, and the flange in both frames of the base."""
    table = Table(box=None, padding=(0, 2, 0, 0))
    for column in ("joint", "from, rad", "to, rad", "by, rad", "at most, rad/s"):
        table.add_column(column, justify="left" if column == "joint" else "right")
    first, last, fastest = trajectory.q[0], trajectory.q[-1], np.max(np.abs(trajectory.qd), axis=0)
    for i, name in enumerate(JOINTS):
        if fastest[i] > _SEEN:
            values = (f"{first[i]:.4f}", f"{last[i]:.4f}", f"{last[i] - first[i]:+.4f}", f"{fastest[i]:.3f}")
            table.add_row(f"{i + 1} {name}", *values)
    Xs = slow.robot.arm.fk(trajectory.q)
    moved = np.linalg.norm(np.diff(Xs[:, :3, 3], axis=0), axis=1)
    speed = float(np.max(moved / np.diff(trajectory.times)))
    arm = slow.config.arm
    console.print(f"[bold]{what}[/bold]")
    console.print(table)
    console.print(
        f"flange from: {_place_text(Xs[0])}\nflange to:   {_place_text(Xs[-1])}\n"
        f"over {float(np.sum(moved)) * 1e3:.0f} mm in {trajectory.duration:.1f} s, at {speed:.3f} m/s at most "
        f"(caps: {max(arm.velocity):g} rad/s, {arm.transfer_acceleration:g} rad/s²)",
        soft_wrap=True,
    )


def _place_text(X_base_flange: Array) -> str:
    places = _places(X_base_flange)
    return ", ".join(f"{frame} ({', '.join(f'{1e3 * v:.1f}' for v in place)} mm)" for frame, place in places)


def _place_figures(X_base_flange: Array) -> dict[str, object]:
    return {f"flange_{frame}": place.tolist() for frame, place in _places(X_base_flange)}


def _places(X_base_flange: Array) -> list[tuple[str, Array]]:
    """The flange's position in both frames of the base [m]."""
    from toolee_robot.frames import BaseFrame, inverse

    frames = (BaseFrame.PENDANT_BASE, BaseFrame.BASE_LINK)
    return [(frame, (inverse(frame.X_base_this) @ X_base_flange)[:3, 3]) for frame in frames]


def _lag_row(trial: Trial) -> str:
    f = trial.figures
    return (
        f"{trial.gain:5.0f} {trial.lookahead:9.2f} {f.speed:8.3f} {1e3 * f.lag:7.1f} {f.gain:9.3f} "
        f"{100 * f.overshoot:9.1f} {1e3 * f.noise:7.3f} {1e3 * f.vibration:9.3f} "
        + ("    -" if f.ratio is None else f"{f.ratio:5.2f}")
        + ("  [red]vibrates[/red]" if f.vibrates else "  [red]too sharp[/red]" if trial.bad else "")
    )


def _acceleration_row(trial: AccelerationTrial) -> str:
    figures = (("deviation", trial.deviation), ("vibration", trial.vibration))
    told = [f"{name} {1e3 * value:.2f} mrad, " for name, value in figures if value is not None]
    told += [] if trial.ratio is None else [f"ratio {trial.ratio:.2f}, "]
    told[:0] = [] if trial.reached is None else [f"reached {trial.reached:.1f}, "]
    sign = f"[red]{escape(trial.sign)}[/red]" if trial.sign else "borne"
    return f"joint {trial.joint} ({JOINTS[trial.joint - 1]}), {trial.acceleration:g} rad/s²: {''.join(told)}{sign}"
