"""The unmodified ur_rtde in a process of its own: its constructors hold the interpreter's lock, its calls may
block for minutes, and it may die of a dropped link. None of that may take the tests with it."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable
from math import pi, sin
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any, Self

TIMEOUT = 30.0  # [s] for a call that should take seconds, on a loaded machine


class UrRtdeDiedError(Exception):
    """The process with ur_rtde has gone. code: its exit code, negative for a signal."""

    def __init__(self, code: int | None) -> None:
        super().__init__(f"ur_rtde's process ended with {code}")
        self.code = code


class UrRtdeHungError(Exception):
    """A call did not return in time."""


class UrRtde:
    """Interfaces of ur_rtde to one robot: "control", "receive", "io", "dashboard"."""

    def __init__(self, host: str) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs, host), daemon=True)
        self._process.start()
        theirs.close()

    def open(self, *interfaces: str) -> None:
        """Construct interfaces; raises RuntimeError with ur_rtde's message."""
        for name in interfaces:
            self._request(("open", name), TIMEOUT)

    def close(self, *interfaces: str) -> None:
        """Disconnect interfaces."""
        for name in interfaces:
            self._request(("close", name), TIMEOUT)

    def call(self, interface: str, method: str, *arguments: object, timeout: float = TIMEOUT) -> Any:
        """A method of an interface; raises RuntimeError with ur_rtde's message."""
        return self._request(("call", interface, method, arguments), timeout)

    def control(self, method: str, *arguments: object) -> Any:
        return self.call("control", method, *arguments)

    def receive(self, method: str, *arguments: object) -> Any:
        return self.call("receive", method, *arguments)

    def run(self, function: Callable[..., Any], *arguments: object, timeout: float = TIMEOUT) -> Any:
        """function(interfaces, *arguments) in ur_rtde's process; function is importable by name."""
        return self._request(("run", function, arguments), timeout)

    def kill(self) -> None:
        """End the process at once, as with SIGKILL."""
        self._process.kill()
        self._process.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.kill()
        self._pipe.close()

    def _request(self, request: tuple[Any, ...], timeout: float) -> Any:
        try:
            self._pipe.send(request)
            if not self._pipe.poll(timeout):
                raise UrRtdeHungError(f"{request[:3]} did not return within {timeout} s")
            done, value = self._pipe.recv()
        except (EOFError, OSError) as error:
            self._process.join(5.0)
            raise UrRtdeDiedError(self._process.exitcode) from error
        if not done:
            raise RuntimeError(value)
        return value


def _work(pipe: Connection, host: str) -> None:
    from dashboard_client import DashboardClient
    from rtde_control import RTDEControlInterface
    from rtde_io import RTDEIOInterface
    from rtde_receive import RTDEReceiveInterface

    def dashboard(host: str) -> Any:
        client = DashboardClient(host)
        client.connect()
        return client

    makers: dict[str, Callable[[str], Any]] = {
        "control": RTDEControlInterface,
        "receive": RTDEReceiveInterface,
        "io": RTDEIOInterface,
        "dashboard": dashboard,
    }
    interfaces: dict[str, Any] = {}
    while True:
        try:
            request = pipe.recv()
        except EOFError:
            return
        try:
            value = None
            if request[0] == "open":
                interfaces[request[1]] = makers[request[1]](host)
            elif request[0] == "close":
                interfaces.pop(request[1]).disconnect()
            elif request[0] == "call":
                value = getattr(interfaces[request[1]], request[2])(*request[3])
            else:
                value = request[1](interfaces, *request[2])
            pipe.send((True, value))
        except Exception as error:  # noqa: BLE001
            pipe.send((False, f"{type(error).__name__}: {error}"))


def servo_sine(interfaces: dict[str, Any], duration: float, amplitude: float, period: float) -> bool:
    """The base joint there and back, on an absolute schedule; whether every call was accepted."""
    control, receive = interfaces["control"], interfaces["receive"]
    start = receive.getActualQ()
    begin, done = time.monotonic(), True
    for i in range(1, round(duration / period) + 1):
        q = [start[0] + amplitude * sin(pi * i * period / duration) ** 2, *start[1:]]
        done &= control.servoJ(q, 0.0, 0.0, period, 0.05, 500)
        time.sleep(max(0.0, begin + i * period - time.monotonic()))
    time.sleep(0.2)
    control.servoStop(10.0)
    return bool(done)


def servo_up(interfaces: dict[str, Any], duration: float, height: float, period: float) -> None:
    """Straight up, on an absolute schedule."""
    control, receive = interfaces["control"], interfaces["receive"]
    pose = receive.getActualTCPPose()
    begin = time.monotonic()
    for i in range(1, round(duration / period) + 1):
        goal = list(pose)
        goal[2] += height * i * period / duration
        control.servoL(goal, 0.0, 0.0, period, 0.05, 500)
        time.sleep(max(0.0, begin + i * period - time.monotonic()))
    time.sleep(0.3)
    control.servoStop(10.0)


def speed_with_kicks(interfaces: dict[str, Any], duration: float) -> bool:
    """A joint at a constant speed, kicked for a while and then left alone."""
    control = interfaces["control"]
    begin = time.monotonic()
    while time.monotonic() < begin + duration:
        control.speedJ([0.0, 0.0, 0.0, 0.0, 0.0, 0.5], 5.0, 0.0)
        control.kickWatchdog()
        time.sleep(0.02)
    return True
