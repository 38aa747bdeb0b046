"""A client's session on the fault port: one JSON object per line in, one per line out."""

from __future__ import annotations

import json
from typing import Any

from toolee_robot.sim_backend.ur_controller.faults.fault_port import Faults
from toolee_robot.sim_backend.ur_controller.server.link import Sink

MAX_WAITING = 65536  # [bytes] of queued requests; a client that sends more is dropped


class FaultSession:
    """A client's session on the fault port.

    Args:
        sink: The client's connection.
        faults: The hooks.
    """

    def __init__(self, sink: Sink, faults: Faults) -> None:
        self._sink, self._faults = sink, faults
        self._buffer = bytearray()

    def feed(self, data: bytes) -> None:
        """Take received bytes and answer at most one request."""
        self._buffer += data
        # One request per tick, since some take milliseconds.
        if (end := self._buffer.find(b"\n")) >= 0:
            line = bytes(self._buffer[:end])
            del self._buffer[: end + 1]
            if line.strip():
                self._sink.send(json.dumps(self._answer(line)).encode() + b"\n")
        if len(self._buffer) > MAX_WAITING:
            self._sink.close()

    def tick(self) -> None:
        """Answer the next queued request."""
        if self._buffer:
            self.feed(b"")

    def close(self) -> None:
        """Nothing to release."""

    def _answer(self, line: bytes) -> dict[str, Any]:
        try:
            request = json.loads(line)
        except (ValueError, RecursionError) as error:
            return {"ok": False, "error": f"not JSON: {error}"}
        return self._faults.do(request)
