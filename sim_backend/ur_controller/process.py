"""A stand-in as a child process: clients whose constructors hold the interpreter's lock need it out of their own.

with ControllerProcess(model="UR10", host="127.0.0.2") as controller:
    ...                                            # connect to 127.0.0.2
    controller.fault("protective_stop")
    print(controller.state()["safety_mode"])
"""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from math import pi
from types import TracebackType
from typing import Any, Self

import numpy as np

from toolee_robot.errors import DeviceError, UserError
from toolee_robot.sim_backend.ur_controller.controller import Controller, ControllerOptions
from toolee_robot.sim_backend.ur_controller.faults.client import FaultClient, Trace
from toolee_robot.sim_backend.ur_controller.robot.joint_plant import JointPlant
from toolee_robot.sim_backend.ur_controller.robot.model import ControllerModel
from toolee_robot.sim_backend.ur_controller.robot.plant import Plant

Q_START = (0.0, -pi / 2, pi / 2, -pi / 2, -pi / 2, 0.0)  # [rad] the flange looks down
STOP_TIME = 5.0  # [s] for the child to end by itself


def resting_joints(model: ControllerModel) -> Plant:
    """Ideal joints without a world, at Q_START. For another start: `functools.partial(JointPlant, q=...)`."""
    return JointPlant(model, np.array(Q_START))


class ControllerProcess:
    """A controller stand-in in a process of its own, listening from `__enter__` on, ended by `__exit__`, or with its
    parent.

    plant: importable by name, since the child makes the plant. setup: likewise; called in the child with the
    controller before it listens (to add a service). inherit: file descriptors that the child has too. realtime: if
    permitted, the child goes before every other process of a busy machine, as a robot's controller has a computer of
    its own. verbose: the child's log goes to stderr.

    Clients must go before the controller: RTDEIOInterface aborts the interpreter otherwise. Hand their closing to
    `on_exit`, or leave them before this context.
    """

    def __init__(
        self,
        options: ControllerOptions | None = None,
        *,
        plant: Callable[[ControllerModel], Plant] = resting_joints,
        setup: Callable[[Controller], None] | None = None,
        inherit: Sequence[int] = (),
        realtime: bool = False,
        verbose: bool = False,
        **changes: Any,
    ) -> None:
        """changes: fields of ControllerOptions, instead of options."""
        if options is not None and changes:
            raise UserError("give either options or their fields")
        self.options = options or ControllerOptions(**changes)
        self._job = pickle.dumps((self.options, plant, setup, verbose))
        self._inherit, self._realtime, self._verbose = inherit, realtime, verbose
        self._child: subprocess.Popen[bytes] | None = None
        self._client: FaultClient | None = None
        self._on_exit: list[Callable[[], object]] = []

    @property
    def host(self) -> str:
        return self.options.host

    @property
    def pid(self) -> int:
        """Of the child."""
        assert self._child is not None, "enter the context first"
        return self._child.pid

    def __enter__(self) -> Self:
        """Raises UserError when a port is taken, DeviceError when the child does not start."""
        self._child = subprocess.Popen(
            [sys.executable, "-m", "toolee_robot.sim_backend.ur_controller.process"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=None if self._verbose else subprocess.DEVNULL,
            pass_fds=self._inherit,
        )
        assert self._child.stdin is not None
        assert self._child.stdout is not None
        try:
            self._child.stdin.write(len(self._job).to_bytes(4, "big") + self._job)
            self._child.stdin.flush()
            answer = self._child.stdout.readline().decode().strip()
            if answer != "ready":
                raise UserError(answer) if answer else DeviceError("the controller stand-in died at its start")
            if self._realtime:
                with contextlib.suppress(PermissionError):
                    os.sched_setscheduler(self._child.pid, os.SCHED_FIFO, os.sched_param(1))
            self._client = FaultClient(self.host, self.options.fault_port)
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for close in reversed(self._on_exit):
            with contextlib.suppress(Exception):
                close()
        self._on_exit.clear()
        self._end()

    def on_exit(self, close: Callable[[], object]) -> None:
        """Call this before the controller is ended, the last one first: for clients."""
        self._on_exit.append(close)

    def fault(self, name: str, /, **arguments: object) -> dict[str, Any]:
        """A hook of the fault port; see the documentation for all of them."""
        assert self._client is not None, "enter the context first"
        return self._client.fault(name, **arguments)

    def state(self) -> dict[str, Any]:
        """The truth about the robot: joints, modes, program, tick statistics."""
        return self.fault("state")

    def trace(self, after: int = -1) -> Trace:
        """What the arm did in every tick after number `after`."""
        assert self._client is not None, "enter the context first"
        return self._client.trace(after)

    def _end(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None
        if (child := self._child) is None:
            return
        for stream in (child.stdin, child.stdout):
            assert stream is not None
            with contextlib.suppress(OSError):
                stream.close()  # the end of its input ends the child
        try:
            child.wait(STOP_TIME)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
        self._child = None


class _Parent:
    """A service that ends the controller when its parent closes the pipe, or dies."""

    def __init__(self, controller: Controller, fd: int) -> None:
        self._controller, self._fd = controller, fd

    def filenos(self) -> Sequence[int]:
        return (self._fd,)

    def on_readable(self, fd: int) -> None:
        if not os.read(fd, 1):
            self._controller.stop()

    def on_tick(self, dt: float) -> None: ...

    def close(self) -> None: ...


def _child() -> None:
    """Serve as the parent's pipe says, until it is closed."""
    # What is sent to every process of a job is the parent's: it ends its clients first, then us.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    pipe = sys.stdin.buffer
    options, plant, setup, verbose = pickle.loads(pipe.read(int.from_bytes(pipe.read(4), "big")))

    def log(line: str) -> None:
        if verbose:
            print(f"[{options.host}] {line}", file=sys.stderr, flush=True)

    try:
        controller = Controller(options, plant, log)
        if setup is not None:
            setup(controller)
        controller.add_service(_Parent(controller, pipe.fileno()))
        controller.listen()
    except UserError as error:
        print(str(error).replace("\n", " "), flush=True)
        return
    print("ready", flush=True)
    controller.run()


if __name__ == "__main__":
    _child()
