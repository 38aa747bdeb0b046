"""Emulate a UR controller, or a hand, for a driver to talk to.

Example: toolee emulate ur --model UR10e --host 127.0.0.3

Example: toolee emulate hand inspire --link hand.port
"""

from __future__ import annotations

import contextlib
import signal
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console
from rich.markup import escape

from toolee_robot.errors import UserError, words_of
from toolee_robot.sim_backend.ur_controller.profile import ProfileName


@dataclass(frozen=True)
class EmulateHand:
    """Emulate a hand on a pseudo-terminal or on TCP.

    Example: toolee emulate hand inspire --handle 400 --link hand.port

    Example: toolee emulate hand inspire --handle 400 --tcp 127.0.0.1:6000

    A driver opens it like the hand's own port. Ctrl-C ends it.

    The first line of standard output is the port: the path of a pseudo-terminal, or an address. Each line of standard
    input is an event. Every hand has these: handle ANGLE, drop, slip ANGLE, heat MOTOR DEGREES, jam MOTOR, free MOTOR,
    mute, unmute, echo, unplug, show. An Inspire hand also has: error MOTOR BITS, deaf, unacknowledged, acknowledge.
    Faults of the next replies, with their number, are: garbage, corrupt, short, late, doubled, foreign, lost. An
    unknown line prints the list. docs/how-to/inspire_hand.md, ability_hand.md and shadow_hand.md say what is emulated.
    """

    hand: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="HAND")]
    """The hand: its name in a station file, such as robotiq_2f85; or inspire, ability, shadow, robotiq."""
    hand_id: Annotated[
        int | None, tyro.conf.arg(metavar="1..254", help_behavior_hint="(default: as delivered, 1 and 80)")
    ] = None
    """Its number on the line, or its unit identifier on Modbus."""
    tcp: Annotated[str | None, tyro.conf.arg(metavar="HOST:PORT", help_behavior_hint="")] = None
    """Address of a hand on a network (port 0: any free port). An Inspire RH56 then speaks Modbus-TCP instead of
    serial.
    """
    handle: Annotated[float | None, tyro.conf.arg(metavar="ANGLE", help_behavior_hint="")] = None
    """Finger angle at which the fingers meet an object in the hand. Inspire: 0 to 1000, 1000 is open. Ability Hand:
    0 to 100 deg. Shadow Hand: 0 to 90 deg of the knuckles. Robotiq: 0 to 255, 0 is open.
    """
    link: Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="")] = None
    """A symbolic link to the pseudo-terminal, removed at the end."""
    seed: int = 0
    """Seed of the line's noise."""

    def run(self) -> int:
        from toolee_robot.devices.hands import wired_hand
        from toolee_robot.devices.hands.ports import tcp_address
        from toolee_robot.robots.hands import HAND_FILES
        from toolee_robot.runtime.clock import is_loopback
        from toolee_robot.sim_backend.hands import LOOPBACK, emulated_hand
        from toolee_robot.sim_backend.hands.kit import happen
        from toolee_robot.station import HandConfig

        model = next((name for name, file in HAND_FILES.items() if self.hand in (name, file)), "")
        kind = wired_hand(model)
        if kind is None:
            raise UserError(f"no emulator for {self.hand!r}: give one of {', '.join(HAND_FILES)}")
        if self.hand_id is not None and not (kind.numbered and 1 <= self.hand_id <= 254):
            raise UserError(f"--hand-id {self.hand_id}: give 1 to 254, or none for a hand without id")
        if self.tcp is not None and kind.scheme is None:
            raise UserError(f"--tcp: {model} has a serial port only. Leave --tcp out")
        listen = LOOPBACK if self.tcp is None else tcp_address(f"tcp://{self.tcp}")
        if not is_loopback(listen[0]):
            raise UserError(f"--tcp {self.tcp}: give an address 127.x.x.x for an emulator", code="user.not_loopback")
        config = HandConfig(model, port=self.tcp and f"{kind.scheme}://{self.tcp}", hand_id=self.hand_id)
        console = Console(stderr=True, highlight=False)
        with emulated_hand(config, self.seed, listen=listen) as emulator, self._linked(emulator.port):
            if self.handle is not None and not 0 <= self.handle <= emulator.most:
                raise UserError(f"--handle {self.handle}: give 0 to {emulator.most:.0f}")
            emulator.hold(self.handle)
            print(emulator.port, flush=True)
            console.print(f"[bold]{emulator.label}[/bold]. [dim]Ctrl-C ends it.[/dim]")
            with contextlib.suppress(KeyboardInterrupt):
                for line in sys.stdin:
                    if not line.split():
                        continue
                    try:
                        told = happen(emulator, line)
                    except UserError as error:
                        told = f"[red]{error}[/red]"
                    console.print(told, soft_wrap=True)
                    if not emulator.plugged:
                        return 0
                signal.pause()
        return 0

    @contextlib.contextmanager
    def _linked(self, port: str) -> Iterator[None]:
        if self.link is None:
            yield
            return
        if "://" in port:
            raise UserError("--link is for serial hands: leave it out, this hand is on a network")
        if self.link.is_symlink():
            self.link.unlink()
        try:
            self.link.symlink_to(port)
        except OSError as error:
            raise UserError(f"--link {self.link}: {words_of(error)}") from error
        try:
            yield
        finally:
            if self.link.is_symlink() and self.link.readlink() == Path(port):
                self.link.unlink()


@dataclass(frozen=True)
class EmulateUr:
    """Emulate a UR controller.

    Example: toolee emulate ur --model UR10e --host 127.0.0.3

    ur_rtde and other clients connect to it as to a robot. It serves RTDE (30004), the dashboard (29999), the script
    ports (30001 to 30003) and a fault port, and runs uploaded scripts. Ctrl-C ends it. It accepts loopback addresses
    only. docs/reference/ur_controller.md says what is modelled.
    """

    model: Literal["UR10", "UR10e"] = "UR10"
    """UR10: CB3, PolyScope 3.15, 125 Hz. UR10e: e-Series, PolyScope 5.11, 500 Hz."""
    host: Annotated[str, tyro.conf.arg(metavar="ADDRESS")] = "127.0.0.2"
    """A loopback address; every robot on this machine needs its own (127.0.0.2, 127.0.0.3, ...)."""
    fault_port: Annotated[int, tyro.conf.arg(metavar="PORT")] = 30020
    """Port for fault injection: one JSON object per line."""
    profile: Annotated[ProfileName, tyro.conf.arg(metavar="ideal|harsh")] = "ideal"
    """How the controller follows, measures and stops. ideal: without errors; harsh: with noise, lag and stops like a
    real one's.
    """
    payload_kg: Annotated[float, tyro.conf.arg(metavar="KG")] = 0.0
    """Mass on the flange that the controller assumes at the start, as set at the pendant."""
    payload_cog: Annotated[tuple[float, float, float], tyro.conf.arg(metavar="X Y Z")] = (0.0, 0.0, 0.0)
    """Centre of gravity of this mass in the flange's axes [m]."""
    seed: int = 0
    """Seed of the sensors' noise in the harsh profile."""
    real_time_factor: Annotated[float, tyro.conf.arg(metavar="0.05..1")] = 1.0
    """Speed of the robot's time; 1 is real time. Clients must use the same value."""

    def run(self) -> int:
        from toolee_robot.sim_backend.ur_controller.controller import Controller, ControllerOptions
        from toolee_robot.sim_backend.ur_controller.process import resting_joints

        console = Console(highlight=False)
        begin = time.monotonic()

        def log(line: str) -> None:
            console.print(f"[dim]{time.monotonic() - begin:9.3f}[/dim]  {escape(line)}", soft_wrap=True)

        controller = Controller(ControllerOptions(**vars(self)), resting_joints, log)
        try:
            controller.listen()
            model = controller.robot.model
            version = ".".join(str(number) for number in controller.robot.identity.version)
            console.print(
                f"[bold]{model.name}[/bold], controller software {version}, {model.rate:.0f} Hz, "
                f"{self.profile} profile, on {self.host}"
            )
            for port in (*controller.ports.values(), controller.fault_port):
                console.print(f"  {port.number}  {port.name}")
            console.print("[dim]Ctrl-C ends it. End its clients first.[/dim]")
            controller.run(realtime=True)
        except KeyboardInterrupt:
            statistics = controller.schedule.statistics
            console.print(
                f"\nEnded after {statistics.ticks} cycles: {statistics.late} late, at worst by "
                f"{1e3 * statistics.worst_late:.1f} ms; {statistics.slipped} skipped; "
                f"{1e3 * statistics.busy / max(1, statistics.ticks):.2f} ms of work per cycle"
            )
        return 0


COMMANDS = {"emulate": {"ur": EmulateUr, "hand": EmulateHand}}
