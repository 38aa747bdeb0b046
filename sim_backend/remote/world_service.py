"""The service in the controller's tick loop that offers hand, person, judge and scene of a simulated world.

Requests come over a pipe from the process that started this one. A request is (number, name, arguments), or None to
end; its answer is (number, done, value or exception). Answers are sent in the order in which commands end: while the
hand closes, its state can be read and it can be stopped.
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any

from toolee_robot.errors import DeviceError, TooleeError
from toolee_robot.hal import Clock, HandState
from toolee_robot.sim_backend.devices.coupled_fingers import CoupledFingers
from toolee_robot.sim_backend.devices.operator import SimPerson
from toolee_robot.sim_backend.ground_truth.judge import Judge
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.remote.device_commands import Commands
from toolee_robot.sim_backend.remote.host_timed_truth import HostTimedTruth
from toolee_robot.sim_backend.station import build_world, draw_handover, simulated_hand
from toolee_robot.sim_backend.visuals.scene import scene_state
from toolee_robot.station import StationConfig

Handler = Callable[..., Any]


class WorldService:
    """A `Service` with hand, person, judge and scene of a world that a `WorldPlant` moves.

    Args:
        connection: This process's end of the pipe.
        config: The station.
        seed: Seed of the run.
        options: Options of the run.
        clock: The controller's clock, on which all stamps are.

    Attributes:
        world: The simulated world.
        ended: Callback for the end of the other process, after which the controller is not needed.
    """

    def __init__(
        self, connection: Connection, config: StationConfig, seed: int, options: SimOptions, clock: Clock
    ) -> None:
        tool, offset = draw_handover(seed, options)
        self.world = world = build_world(config, tool, options)
        self.ended: Callable[[], None] = lambda: None
        self._connection, self._clock = connection, clock
        self._commands = Commands(world)
        self._hand = hand = simulated_hand(world, options)
        fingers = CoupledFingers(world, options.friction)
        person = SimPerson(world, offset, options.hands_over)
        judge = Judge(HostTimedTruth(world, clock))
        world.after_step.append(judge.after_step)
        # Commands that take time, with their device: each device executes one at a time.
        self._lasting: dict[str, tuple[str, Handler]] = {
            "hand.open": ("hand", hand.open),
            "hand.close": ("hand", hand.close),
            "fingers.grip": ("hand", fingers.grip),
            "person.request_handover": ("person", person.request_handover),
            "person.release": ("person", person.release),
            "person.take_tool": ("person", person.take_tool),
            "person.confirm_swing": ("person", person.confirm_swing),
            "person.confirm_inspection": ("person", person.confirm_inspection),
            "person.hold_switch": ("person", person.hold_switch),
        }
        self._immediate: dict[str, Handler] = {
            "hand.state": self._hand_state,
            "hand.stop": self._stop_hand,
            "fingers.follow": fingers.follow,
            "fingers.let_go": fingers.let_go,
            "person.zone_occupied": person.zone_occupied,
            "person.hold_to_run_held": person.hold_to_run_held,
            "scene": lambda: scene_state(world, person),
            "judge.strikes": lambda: judge.strikes,
            "judge.X_hand_ee": judge.X_hand_ee,
            "judge.verdict": judge.verdict,
        }

    def filenos(self) -> Sequence[int]:
        """The pipe's descriptor."""
        return () if self._connection.closed else (self._connection.fileno(),)

    def on_readable(self, fd: int) -> None:  # noqa: ARG002  (there is one)
        """Handle a request."""
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
            message = f"the simulated world knows no {name!r}"
            self._send(number, False, DeviceError(message, code="device.unknown_request"))

    def on_tick(self, dt: float) -> None:
        """Nothing: the world's steps resume the commands."""

    def close(self) -> None:
        """Close the pipe and the world."""
        self._connection.close()
        self.world.close()

    def _answer(self, number: int, handler: Handler, arguments: tuple[Any, ...]) -> None:
        try:
            value = handler(*arguments)
        except TooleeError as error:
            self._send(number, False, error)
        except Exception as error:  # noqa: BLE001  (passed to the caller; the arm's controller must continue)
            traceback.print_exc(file=sys.stderr)
            message = f"the simulated world failed: {type(error).__name__}: {error}"
            self._send(number, False, DeviceError(message, code="device.world_failed"))
        else:
            self._send(number, True, value)

    def _send(self, number: int, done: bool, value: Any) -> None:
        with suppress(OSError):  # closed: the next read notices
            self._connection.send((number, done, value))

    def _hand_state(self, max_age: float) -> HandState:
        state = self._hand.state(max_age)
        age = self.world.time - state.joints.stamp
        return replace(state, joints=replace(state.joints, stamp=self._clock.now() - age))

    def _stop_hand(self) -> None:
        self._commands.cancel("hand", "the hand was stopped; it keeps its position and its grip")
        self._hand.stop()
