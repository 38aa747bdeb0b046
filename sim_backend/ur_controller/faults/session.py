"""A client of the fault port: a JSON object per line in, one per line out."""

from __future__ import annotations

import json
from typing import Any

from toolee_robot.sim_backend.ur_controller.faults.fault_port import Faults
from toolee_robot.sim_backend.ur_controller.server.link import Sink

MAX_WAITING = 65536  # [bytes] of requests that wait; a client that sends more is dropped


class FaultSession:
    """A client of the fault port."""

    def __init__(self, sink: Sink, faults: Faults) -> None:
        self._sink, self._faults = sink, faults
        self._buffer = bytearray()

    def feed(self, data: bytes) -> None:
        self._buffer += data
        # One at a time, the next one after the next tick: some take milliseconds.
        if (end := self._buffer.find(b"\n")) >= 0:
            line = bytes(self._buffer[:end])
            del self._buffer[: end + 1]
            if line.strip():
                self._sink.send(json.dumps(self._answer(line)).encode() + b"\n")
        if len(self._buffer) > MAX_WAITING:
            self._sink.close()

    def tick(self) -> None:
        if self._buffer:
            self.feed(b"")

    def close(self) -> None: ...

    def _answer(self, line: bytes) -> dict[str, Any]:
        try:
            request = json.loads(line)
        except (ValueError, RecursionError) as error:
            return {"ok": False, "error": f"not JSON: {error}"}
        return self._faults.do(request)
