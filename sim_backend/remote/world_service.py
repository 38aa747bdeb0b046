"""What a station needs of a simulated world besides the arm, as a service in the controller's tick loop.

Requests come from the process that started this one, over the pipe between the two; nobody else can reach it. A
request is (number, name, arguments), or None for goodbye; its answer (number, done, value or exception). Answers come
in the order in which commands end: a hand that closes keeps nobody from reading its state, or from stopping it.
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any

from toolee_robot.config import StationConfig
from toolee_robot.errors import DeviceError, TooleeError
from toolee_robot.hal import Clock, HandState
from toolee_robot.sim_backend.devices.hand import SimHand
from toolee_robot.sim_backend.devices.operator import SimPerson
from toolee_robot.sim_backend.ground_truth.judge import Judge
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.remote.device_commands import Commands
from toolee_robot.sim_backend.remote.host_timed_truth import HostTimedTruth
from toolee_robot.sim_backend.station import build_world, draw_handover
from toolee_robot.sim_backend.visuals.scene import scene_state

Handler = Callable[..., Any]


class WorldService:
    """A `Service` with hand, person, judge and the scene's poses of a world that a `WorldPlant` moves.

    ended: called once the other side has gone; the controller has no purpose then. Stamps are on `clock`, the
    controller's.
    """

    def __init__(
        self, connection: Connection, config: StationConfig, seed: int, options: SimOptions, clock: Clock
    ) -> None:
        tool, offset = draw_handover(seed, options)
        self.world = world = build_world(config, tool, options)
        self.ended: Callable[[], None] = lambda: None
        self._connection, self._clock = connection, clock
        self._commands = Commands(world)
        self._hand = hand = SimHand(world, options.friction)
        person = SimPerson(world, offset, options.hands_over)
        judge = Judge(HostTimedTruth(world, clock))
        world.after_step.append(judge.after_step)
        # What lets time pass, by device: one command at a time each.
        self._lasting: dict[str, tuple[str, Handler]] = {
            "hand.open": ("hand", hand.open),
            "hand.close": ("hand", hand.close),
            "person.request_handover": ("person", person.request_handover),
            "person.release": ("person", person.release),
            "person.take_tool": ("person", person.take_tool),
            "person.confirm_swing": ("person", person.confirm_swing),
        }
        self._immediate: dict[str, Handler] = {
            "hand.state": self._hand_state,
            "hand.stop": self._stop_hand,
            "person.zone_occupied": person.zone_occupied,
            "person.enabling_switch_held": person.enabling_switch_held,
            "scene": lambda: scene_state(world, person),
            "judge.strikes": lambda: judge.strikes,
            "judge.X_hand_ee": judge.X_hand_ee,
            "judge.verdict": judge.verdict,
        }

    def filenos(self) -> Sequence[int]:
        return () if self._connection.closed else (self._connection.fileno(),)

    def on_readable(self, fd: int) -> None:  # noqa: ARG002  (there is one)
        request = None
        with suppress(EOFError, OSError):
            request = self._connection.recv()
        if request is None:
            self._connection.close()
            self.ended()
            return
        number, name, arguments = request
        if name in self._lasting:
            device, handler = self._lasting[name]
            try:
                self._commands.start(device, lambda: self._answer(number, handler, arguments))
            except DeviceError as error:
                self._send(number, False, error)
        elif name in self._immediate:
            self._answer(number, self._immediate[name], arguments)
        else:
            self._send(number, False, DeviceError(f"the simulated world knows no {name!r}"))

    def on_tick(self, dt: float) -> None:
        """The world's own steps wake the commands."""

    def close(self) -> None:
        self._connection.close()
        self.world.close()

    def _answer(self, number: int, handler: Handler, arguments: tuple[Any, ...]) -> None:
        try:
            value = handler(*arguments)
        except TooleeError as error:
            self._send(number, False, error)
        except Exception as error:  # noqa: BLE001  (the caller gets it; the arm's controller must go on)
            traceback.print_exc(file=sys.stderr)
            self._send(number, False, DeviceError(f"the simulated world failed: {type(error).__name__}: {error}"))
        else:
            self._send(number, True, value)

    def _send(self, number: int, done: bool, value: Any) -> None:
        with suppress(OSError):  # gone: the next read says so
            self._connection.send((number, done, value))

    def _hand_state(self, max_age: float) -> HandState:
        state = self._hand.state(max_age)
        age = self.world.time - state.joints.stamp
        return replace(state, joints=replace(state.joints, stamp=self._clock.now() - age))

    def _stop_hand(self) -> None:
        self._commands.cancel("hand", "the hand was stopped; it stays as it is, its grip too")
        self._hand.stop()
