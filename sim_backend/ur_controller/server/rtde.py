"""Real-Time Data Exchange, port 30004: a client's session (UR, "RTDE guide"; protocol versions 1 and 2).

Two details matter to clients that read exactly one packet after each request: lists of names may end with a comma, and
nothing is sent between a request and its answer, nor any data or text before the start is acknowledged.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass

from toolee_robot.sim_backend.ur_controller.robot_system import Robot
from toolee_robot.sim_backend.ur_controller.server import rtde_types as wire
from toolee_robot.sim_backend.ur_controller.server.port import Sink
from toolee_robot.sim_backend.ur_controller.server.rtde_types import Recipe
from toolee_robot.sim_backend.ur_controller.server.rtde_variables import Inputs, Outputs

MAX_RECIPES = 255  # an id is a byte, 0 means refused
MAX_NAMES = 512  # names in a recipe, above which the client is dropped: more than exist, less than a packet can hold
QUEUE = 512  # packets of a stream that may wait for their ticks
MAX_WAITING = 1 << 20  # [bytes] of unprocessed data from a client above which it is dropped
SKIP_BACKLOG = 65536  # [bytes] unread by the client above which data packets are omitted
_WARNING = 2  # level of a text message


@dataclass
class RtdeFaults:
    """Faults of the RTDE server.

    Attributes:
        drop_after: Number of packets after which the next client is dropped, in the middle of its handshake; None for
            no fault.
        reset: Whether it is dropped with RST.
    """

    drop_after: int | None = None
    reset: bool = False


class RtdeSession:
    """A client's session on the RTDE server.

    Args:
        sink: The client's connection.
        robot: The robot.
        outputs: Output variables.
        inputs: Input variables.
        faults: Faults of the server.

    Attributes:
        skipped: Data packets omitted because the client does not read.
    """

    def __init__(self, sink: Sink, robot: Robot, outputs: Outputs, inputs: Inputs, faults: RtdeFaults) -> None:
        self.skipped = 0
        self._sink, self._robot, self._outputs, self._inputs, self._faults = sink, robot, outputs, inputs, faults
        self._buffer = bytearray()
        self._version, self._started = 1, False
        self._output: Recipe | None = None
        self._every = 1.0  # ticks between two data packets
        self._due = 0.0  # tick
        self._input_recipes: list[Recipe] = []
        self._to_skip = 0
        self._drop_after, faults.drop_after = faults.drop_after, None
        self._ended = False
        self._written = 0  # the last input recipe written since the last tick; 0 for none

    def feed(self, data: bytes) -> None:
        """Take received bytes and handle each complete packet."""
        self._buffer += data
        if len(self._buffer) > MAX_WAITING:
            self._end()
        while not self._ended and len(self._buffer) >= wire.HEADER.size:
            size, kind = wire.HEADER.unpack_from(self._buffer)
            if size < wire.HEADER.size:  # the framing is lost
                self._end()
                return
            if len(self._buffer) < size:
                return
            if kind == wire.DATA and self._must_wait(size):
                return
            payload = bytes(self._buffer[wire.HEADER.size : size])
            del self._buffer[:size]
            self._handle(kind, payload)

    def tick(self) -> None:
        """Send the subscribed data if due, and handle packets that had to wait for this tick."""
        self._publish()
        self._written = 0
        self.feed(b"")

    def _must_wait(self, size: int) -> bool:
        """Whether the next packet must wait for a later tick.

        While ticks are caught up, one packet of a stream is taken per tick. There may be fewer such ticks than packets,
        since the schedule does not catch up all lost time.
        """
        if not (self._written and self._inputs.catching_up) or len(self._buffer) > QUEUE * size:
            return False
        return len(self._buffer) > wire.HEADER.size and self._buffer[wire.HEADER.size] == self._written

    def _publish(self) -> None:
        recipe = self._output
        if not self._started or recipe is None or self._ended or self._robot.ticks < self._due:
            return
        # On the grid of the ticks, so a rate that does not divide the controller's is met on average.
        self._due = max(self._due + self._every, self._robot.ticks + 1.0 - self._every)
        if self._to_skip > 0:
            self._to_skip -= 1
            return
        if self._sink.backlog > SKIP_BACKLOG:
            self.skipped += 1
            return
        prefix = b"\x01" if self._version >= 2 else b""
        data = recipe.layout.pack(*self._outputs.values(recipe.names))
        self._sink.send(wire.packet(wire.DATA, prefix + data))

    def skip(self, packets: int) -> None:
        """Omit the next `packets` data packets."""
        self._to_skip = packets

    def text(self, message: str, level: int = _WARNING) -> None:
        """Send a text message, once data have been started.

        Args:
            message: The text.
            level: Level of the message: 0 exception, 1 error, 2 warning, 3 info.
        """
        if not self._started:
            return
        body = message.encode("ascii", "replace")[:255]
        if self._version >= 2:
            source = b"RTDE"
            payload = bytes([len(body)]) + body + bytes([len(source)]) + source + bytes([level])
        else:
            payload = bytes([level]) + body
        self._sink.send(wire.packet(wire.TEXT, payload))

    def close(self) -> None:
        """Release the client's input variables."""
        self._ended = True
        self._inputs.release(self)

    def _end(self, reset: bool = False) -> None:
        self._ended = True
        self._sink.close(reset)

    def _handle(self, kind: int, payload: bytes) -> None:
        if self._drop_after is not None:
            self._drop_after -= 1
            if self._drop_after <= 0:
                self._end(self._faults.reset)
                return
        if kind == wire.DATA:
            self._write(payload)
        elif kind == wire.PROTOCOL_VERSION:
            asked = int.from_bytes(payload, "big") if len(payload) == 2 else 0
            accepted = asked in (1, 2) and not self._started
            if accepted:
                self._version = asked
            self._answer(kind, bytes([accepted]))
        elif kind == wire.CONTROLLER_VERSION:
            self._answer(kind, struct.pack(">4I", *self._robot.identity.version))
        elif kind == wire.OUTPUTS:
            self._set_outputs(payload)
        elif kind == wire.INPUTS:
            self._set_inputs(payload)
        elif kind in (wire.START, wire.PAUSE):
            self._started = kind == wire.START
            self._due = self._robot.ticks + 1.0
            self._answer(kind, b"\x01")
        elif kind == wire.TEXT:
            self._robot.log(f"RTDE client says: {payload[1:].decode('ascii', 'replace')!r}")
        else:
            self.text(f"unknown packet type {kind}")

    def _answer(self, kind: int, payload: bytes) -> None:
        self._sink.send(wire.packet(kind, payload))

    def _set_outputs(self, payload: bytes) -> None:
        rate, names = self._robot.model.rate, payload
        frequency = rate
        if self._version >= 2:
            if len(payload) < 8:
                self._answer(wire.OUTPUTS, b"\x00")
                return
            (frequency,), names = struct.unpack(">d", payload[:8]), payload[8:]
        if (recipe := self._recipe(names, self._outputs.type_of)) is None:
            return
        valid = bool(recipe.names) and "NOT_FOUND" not in recipe.types
        valid = valid and math.isfinite(frequency) and frequency > 0.0
        self._output = recipe if valid else None
        if valid:
            self._every = rate / min(max(frequency, 1.0), rate)
        prefix = bytes([valid]) if self._version >= 2 else b""
        self._answer(wire.OUTPUTS, prefix + ",".join(recipe.types).encode())

    def _set_inputs(self, payload: bytes) -> None:
        if (recipe := self._recipe(payload, lambda name: self._inputs.claim(name, self))) is None:
            return
        valid = bool(recipe.names) and not {"NOT_FOUND", "IN_USE"}.intersection(recipe.types)
        valid = valid and len(self._input_recipes) < MAX_RECIPES
        number = 0
        if valid:
            self._input_recipes.append(recipe)
            number = len(self._input_recipes)
        self._answer(wire.INPUTS, bytes([number]) + ",".join(recipe.types).encode())

    def _recipe(self, payload: bytes, type_of: Callable[[str], str]) -> Recipe | None:
        names = wire.split_names(payload)
        if len(names) > MAX_NAMES:
            self._end()
            return None
        return Recipe(names, tuple(type_of(name) for name in names))

    def _write(self, payload: bytes) -> None:
        number = payload[0] if payload else 0
        if not 1 <= number <= len(self._input_recipes):
            self.text(f"data for an input recipe {number} that was not set up")
            return
        recipe = self._input_recipes[number - 1]
        if len(payload) - 1 != recipe.layout.size:
            self.text(f"data of {len(payload) - 1} bytes for input recipe {number} of {recipe.layout.size} bytes")
            return
        self._written = number
        self._inputs.write(recipe.names, recipe.layout.unpack(payload[1:]))
