"""`toolee hand-emulator`: an emulated hand on a pseudo-terminal or on TCP, for a driver to talk to."""

from __future__ import annotations

import contextlib
import signal
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console

from toolee_robot.errors import UserError, words_of

_HANDS = {"inspire": ("inspire_rh56", 1000.0), "ability": ("ability_hand", 100.0), "shadow": ("shadow_right", 90.0)}
"""What is emulated -> what a station file calls it, largest angle."""


@dataclass(frozen=True)
class HandEmulator:
    """Emulate a hand on a pseudo-terminal or on TCP: a driver opens it as it opens the hand's port. Ctrl-C ends it.

    Examples: toolee hand-emulator inspire --handle 400 --link hand.port;
    toolee hand-emulator inspire --handle 400 --tcp 127.0.0.1:6000

    The first line of standard output is the port: the path of a pseudo-terminal, or an address. Each line of standard
    input is an event: handle ANGLE, drop, slip ANGLE, heat MOTOR DEGREES, jam MOTOR, free MOTOR, mute, unmute, echo,
    unplug, show, of an Inspire hand error MOTOR BITS, deaf, unacknowledged and acknowledge (writes), or a fault of the
    next replies and their number: garbage, corrupt, short, late, doubled, foreign, lost. Another line is answered by
    those that there are. docs/how-to/inspire_hand.md, ability_hand.md and shadow_hand.md say what is emulated.
    """

    hand: Annotated[Literal["inspire", "ability", "shadow"], tyro.conf.Positional]
    """The hand: an Inspire RH56 on RS-485 or Modbus-TCP, a PSYONIC Ability Hand on a UART with byte stuffing, or a
    right Shadow Hand behind a rosbridge."""
    hand_id: Annotated[
        int | None, tyro.conf.arg(metavar="1..254", help_behavior_hint="(default: as delivered, 1 and 80)")
    ] = None
    """Its number on the line, of Modbus its unit identifier."""
    tcp: Annotated[str | None, tyro.conf.arg(metavar="HOST:PORT", help_behavior_hint="")] = None
    """Where it listens (port 0: at a free one): the Shadow Hand's rosbridge, by default on this computer, or an Inspire
    RH56 on Modbus-TCP instead of the pseudo-terminal."""
    handle: Annotated[float | None, tyro.conf.arg(metavar="ANGLE", help_behavior_hint="")] = None
    """Something lies in the hand, met by fingers and thumb at this angle: 0 to 1000 as the Inspire counts, where 1000
    is open; 0 to 100 deg of the Ability Hand and 0 to 90 deg of the Shadow Hand's knuckles, where 0 is open."""
    link: Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="")] = None
    """A symbolic link to the pseudo-terminal, made for the time being."""
    seed: int = 0
    """Seed of the line's noise."""

    def run(self) -> int:
        from toolee_robot.devices.hands.inspire.tcp_port import tcp_address
        from toolee_robot.sim_backend.hand_wire import happen
        from toolee_robot.sim_backend.hands import LOOPBACK, emulated_hand
        from toolee_robot.station import HandConfig

        if self.hand_id is not None and not 1 <= self.hand_id <= 254:
            raise UserError(f"--hand-id {self.hand_id}: a hand's number is 1 to 254", code="user.option")
        model, most = _HANDS[self.hand]
        if self.handle is not None and not 0 <= self.handle <= most:
            raise UserError(f"--handle {self.handle}: give 0 to {most:.0f}", code="user.option")
        console = Console(stderr=True, highlight=False)
        on_terminal = self.tcp is None and self.hand != "shadow"
        if self.link is not None and not on_terminal:
            raise UserError("--link is for a pseudo-terminal: leave it out with --tcp and shadow", code="user.option")
        address = None if self.tcp is None else f"tcp://{self.tcp}"
        config = HandConfig(model, port=None if self.hand == "shadow" else address, hand_id=self.hand_id)
        listen = LOOPBACK if address is None else tcp_address(address)
        with emulated_hand(config, self.seed, listen=listen) as emulator, self._linked(emulator.port):
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
        if self.link.is_symlink():
            self.link.unlink()
        try:
            self.link.symlink_to(port)
        except OSError as error:
            raise UserError(f"--link {self.link}: {words_of(error)}", code="user.option") from error
        try:
            yield
        finally:
            if self.link.is_symlink() and self.link.readlink() == Path(port):
                self.link.unlink()


COMMANDS = {"": HandEmulator}
