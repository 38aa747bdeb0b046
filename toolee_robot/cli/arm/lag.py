"""`toolee arm lag`: measures the servo's lag and recommends its settings."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console

from toolee_robot.cli.arm.options import MotionOptions
from toolee_robot.cli.options import Flag
from toolee_robot.cli.output import json_line
from toolee_robot.errors import UserError

if TYPE_CHECKING:
    from toolee_robot.control import Supervisor
    from toolee_robot.tasks.bring_up.servo_tuning import Trial

EXIT_FAILED = 1
_HEADER = " gain lookahead    speed     lag amplitude overshoot   noise vibration ratio"
_UNITS = "            [s]  [rad/s]    [ms]                 [%]  [mrad]    [mrad]"


@dataclass(frozen=True, kw_only=True)
class Lag(MotionOptions):
    """Measure the servo's lag on one joint: a sine, then a step, of rising speed, from gentle settings to sharp ones.

    Example: toolee arm lag --robot-host 192.168.1.10 --config lab.yaml --joint 1 --write

    Ends at the first sign of vibration: listen to the arm, and press a key if it hums. Exit code 1: already the
    gentlest settings are bad.
    """

    joint: Annotated[int, tyro.conf.arg(metavar="1..6")] = 1
    """Joint that moves: 1 base, 2 shoulder, 3 elbow, 4 to 6 wrists."""
    write: Flag = False
    """Write the recommended gain, lookahead and lag into the station file, under servo; the rest of it stays."""

    def run(self) -> int:
        if self.write and self.config is None:
            raise UserError("--write needs --config: the station file to write to", code="user.option")
        console = Console(stderr=self.json, highlight=False)
        station, host = self.load()
        from toolee_robot.cli.arm.session import Session
        from toolee_robot.cli.arm.terminal import TerminalPerson
        from toolee_robot.runtime.yaml_edit import set_fields
        from toolee_robot.stations.ur import open_arm
        from toolee_robot.tasks.bring_up.caps import Caps, SlowStation
        from toolee_robot.tasks.bring_up.lag_motion import lag_motion
        from toolee_robot.tasks.bring_up.servo_tuning import PAIRS, SHARES, recommend, tune

        slow = SlowStation.of(station, Caps(self.max_speed, self.max_acceleration))
        person = TerminalPerson(console, absent=self.yes)

        @contextmanager
        def open_with(gain: float, lookahead: float) -> Iterator[Supervisor]:
            servo = replace(slow.config.servo, gain=gain, lookahead=lookahead, lag=None)
            with open_arm(replace(slow.config, servo=servo), host, person) as arm:
                yield arm

        with open_with(*PAIRS[0]) as arm:
            robot = Session(arm, slow, person, console)
            limits = slow.config.arm
            motion = lag_motion(robot.q, self.joint, limits.velocity[self.joint - 1], limits)
            robot.show(f"lag of joint {self.joint}: up to {len(PAIRS) * len(SHARES)} times", motion.trajectory)
            console.print(f"to both sides of where it is, by {motion.reach:.3f} rad at most")
        person.confirm("Move?")
        console.print(f"{_HEADER}\n{_UNITS}", markup=False, soft_wrap=True)
        trials: list[Trial] = []
        with person.attending():
            for trial in tune(open_with, slow, self.joint):
                trials.append(trial)
                console.print(_row(trial), soft_wrap=True)
        best = recommend(trials)
        if best is None:
            console.print("[red]Already the gentlest settings are bad:[/red] look at payload, mount and load.")
        else:
            words = f"gain {best.gain:g}, lookahead {best.lookahead:g} s, lag {best.lag:g} s"
            console.print(
                f"[bold]Recommended: {words}[/bold]. Measured at up to {limits.velocity[self.joint - 1]:g} rad/s.",
                soft_wrap=True,
            )
        if best is not None and self.write and self.config is not None:
            set_fields(self.config, ("servo",), asdict(best))
            console.print(f"Written to {self.config}.")
        if self.json:
            told = [{"gain": t.gain, "lookahead": t.lookahead, **asdict(t.figures)} for t in trials]
            print(json_line({"trials": told, "recommended": None if best is None else asdict(best)}), flush=True)
        return EXIT_FAILED if best is None else 0


def _row(trial: Trial) -> str:
    f = trial.figures
    return (
        f"{trial.gain:5.0f} {trial.lookahead:9.2f} {f.speed:8.3f} {1e3 * f.lag:7.1f} {f.gain:9.3f} "
        f"{100 * f.overshoot:9.1f} {1e3 * f.noise:7.3f} {1e3 * f.vibration:9.3f} "
        + ("    -" if f.ratio is None else f"{f.ratio:5.2f}")
        + ("  [red]vibrates[/red]" if f.vibrates else "  [red]too sharp[/red]" if trial.bad else "")
    )
