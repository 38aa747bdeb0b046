"""`toolee hand-emulator`: an emulated hand for a driver to talk to."""

from __future__ import annotations

import contextlib
import signal
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console

from toolee_robot.errors import UserError

_HANDS = {"inspire": ("inspire_rh56", 1000.0), "ability": ("ability_hand", 100.0), "shadow": ("shadow_right", 90.0)}
"""What is emulated -> what a station file calls it, largest angle."""


@dataclass(frozen=True)
class HandEmulator:
    """Emulate a hand: a driver opens it as it opens the hand's port. Ctrl-C ends it.

    Example: toolee hand-emulator inspire --handle 400 --link hand.port

    The first line of standard output is the port: the path of a pseudo-terminal, or the address of a rosbridge. Each
    line of standard input is an event: handle ANGLE, drop, slip ANGLE, heat MOTOR DEGREES, jam MOTOR, free MOTOR, mute,
    unmute, echo, unplug, show, or a fault of the next replies and their number: garbage, corrupt, short, late, doubled,
    foreign, lost. Another line is answered by those that there are. docs/how-to/inspire_hand.md, ability_hand.md and
    shadow_hand.md say what is emulated.
    """

    hand: Annotated[Literal["inspire", "ability", "shadow"], tyro.conf.Positional]
    """The hand: an Inspire RH56 on RS-485, a PSYONIC Ability Hand on a UART with byte stuffing, or a right Shadow Hand
    behind a rosbridge on this computer."""
    hand_id: Annotated[
        int | None, tyro.conf.arg(metavar="1..254", help_behavior_hint="(default: as delivered, 1 and 80)")
    ] = None
    """Its number on a serial line."""
    handle: Annotated[float | None, tyro.conf.arg(metavar="ANGLE", help_behavior_hint="")] = None
    """Something lies in the hand, met by fingers and thumb at this angle: 0 to 1000 as the Inspire counts, where 1000
    is open; 0 to 100 deg of the Ability Hand and 0 to 90 deg of the Shadow Hand's knuckles, where 0 is open."""
    link: Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="")] = None
    """A symbolic link to the pseudo-terminal, made for the time being."""
    tcp_port: Annotated[int | None, tyro.conf.arg(metavar="0..65535", help_behavior_hint="(default: any)")] = None
    """TCP port of the rosbridge; the usual one is 9090."""
    seed: int = 0
    """Seed of the line's noise."""

    def run(self) -> int:
        from toolee_robot.config import HandConfig
        from toolee_robot.sim_backend.hand_wire import HandEmulator as EmulatedHand
        from toolee_robot.sim_backend.hand_wire import happen
        from toolee_robot.sim_backend.shadow_hand import ShadowEmulator
        from toolee_robot.stations.hand import emulated_hand

        if self.hand_id is not None and not 1 <= self.hand_id <= 254:
            raise UserError(f"--hand-id {self.hand_id}: a hand's number is 1 to 254", code="user.option")
        model, most = _HANDS[self.hand]
        if self.handle is not None and not 0 <= self.handle <= most:
            raise UserError(f"--handle {self.handle}: give 0 to {most:.0f}", code="user.option")
        console = Console(stderr=True, highlight=False)
        on_network = self.hand == "shadow"
        given = {"--hand-id": self.hand_id, "--link": self.link} if on_network else {"--tcp-port": self.tcp_port}
        if wrong := ", ".join(name for name, value in given.items() if value is not None):
            raise UserError(f"{wrong} is not for the {self.hand} hand: leave it out", code="user.option")
        if on_network:
            hand: EmulatedHand[Any] = ShadowEmulator(self.seed, tcp_port=self.tcp_port or 0)
        else:
            hand = emulated_hand(HandConfig(model, hand_id=self.hand_id), self.seed)
        with hand as emulator, self._linked(emulator.port):
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
            raise UserError(f"--link {self.link}: {error.strerror}", code="user.option") from error
        try:
            yield
        finally:
            if self.link.is_symlink() and self.link.readlink() == Path(port):
                self.link.unlink()
