"""The device at the other end of `examples/serial_hand.py`'s line: a three-finger hand on a pseudo-terminal."""

from __future__ import annotations

import os
import threading
import time
import tty
from types import TracebackType
from typing import Self

import numpy as np

from tests.robots.three_finger import THREE_FINGER_HAND
from toolee_robot.frames import Array

SPEED = 20.0  # [rad/s]


class HandDevice:
    """Fingers run to their goals, or to `handle` [rad] where one lies in them; `silent`: it answers nothing."""

    def __init__(self) -> None:
        self._ours, theirs = os.openpty()
        tty.setraw(theirs)
        self._theirs = theirs
        self.port = os.ttyname(theirs)
        self.handle: float | None = None
        self.silent = self.jammed = False
        self.asked: list[str] = []
        self._q = self._goal = THREE_FINGER_HAND.posture("open")
        self._since = time.monotonic()
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.write(self._theirs, b"quit\n")  # wakes the thread; as if the driver had sent it
        os.close(self._theirs)
        self._thread.join(2.0)
        os.close(self._ours)

    def _serve(self) -> None:
        try:
            with os.fdopen(os.dup(self._ours), "rb", buffering=0) as lines:
                for line in lines:
                    self.asked.append(line.decode().strip())
                    if not self.silent:
                        os.write(self._ours, self._answer(self.asked[-1]).encode() + b"\n")
        except OSError:  # the driver's side is closed
            return

    def _answer(self, line: str) -> str:
        command, *numbers = line.split()
        self._run()
        if command == "goal":
            self._goal = np.array([float(number) for number in numbers])
        elif command == "hold":
            self._goal = self._q
        else:
            moves = self.jammed or bool(np.abs(self._q - self._reachable()).max() > 1e-3)
            force = 5.0 if self.handle is not None and self._q.max() > self.handle - 0.01 else 0.0
            angles = " ".join(f"{angle:.4f}" for angle in self._q)
            return f"{int(moves)} {angles} " + " ".join([f"{force:.2f}"] * len(THREE_FINGER_HAND.fingers))
        return "ok"

    def _reachable(self) -> Array:
        return self._goal if self.handle is None else np.minimum(self._goal, self.handle)

    def _run(self) -> None:
        now = time.monotonic()
        step, self._since = SPEED * (now - self._since), now
        self._q = self._q + np.clip(self._reachable() - self._q, -step, step)
