"""A stand-in in a child process, for clients such as ur_rtde whose constructors hold the interpreter's lock.

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
from typing import Any, Self

import numpy as np

from toolee_robot.errors import DeviceError, UserError
from toolee_robot.sim_backend.ur_controller.controller import Controller, ControllerOptions
from toolee_robot.sim_backend.ur_controller.faults.fault_port import FaultClient, Trace
from toolee_robot.sim_backend.ur_controller.robot.plant import ControllerModel, JointPlant, Plant

Q_START = (0.0, -pi / 2, pi / 2, -pi / 2, -pi / 2, 0.0)  # [rad] the flange points down
STOP_TIME = 5.0  # [s] for the child to end before it is killed


def resting_joints(model: ControllerModel) -> Plant:
    """Create ideal joints without a world, at Q_START; for another start use `functools.partial(JointPlant, q=...)`."""
    return JointPlant(model, np.array(Q_START))


class ControllerProcess:
    """A controller stand-in in a child process, which listens inside the context and ends with its parent.

    Clients must close before the controller, since RTDEIOInterface aborts the interpreter otherwise: register their
    closing with `on_exit`, or leave them before this context.

    Args:
        options: Initial state.
        plant: Creates the plant in the child; must be importable by name.
        setup: Called in the child with the controller before it listens, for example to add a service; must be
            importable by name.
        inherit: File descriptors that the child inherits.
        realtime: Whether the child gets real-time priority if permitted, as a real controller has its own computer.
        verbose: Whether the child's log is written to stderr.
        changes: Fields of ControllerOptions, instead of `options`.

    Attributes:
        options: Initial state.

    Raises:
        UserError: Both options and fields of them are given.
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
        if options is not None and changes:
            raise UserError("give either options or their fields")
        self.options = options or ControllerOptions(**changes)
        self._job = pickle.dumps((self.options, plant, setup, verbose, realtime))
        self._inherit, self._verbose = inherit, verbose
        self._child: subprocess.Popen[bytes] | None = None
        self._client: FaultClient | None = None
        self._on_exit: list[Callable[[], object]] = []

    @property
    def host(self) -> str:
        """Address of the controller."""
        return self.options.host

    @property
    def pid(self) -> int:
        """Process id of the child."""
        assert self._child is not None, "enter the context first"
        return self._child.pid

    def __enter__(self) -> Self:
        """Start the child.

        Raises:
            UserError: An option is unusable, or a port is taken.
            DeviceError: The child does not start.
        """
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
                if answer:
                    raise UserError(answer)
                raise DeviceError("the emulated controller died at its start")
            self._client = FaultClient(self.host, self.options.fault_port)
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        for close in reversed(self._on_exit):
            with contextlib.suppress(Exception):
                close()
        self._on_exit.clear()
        self._end()

    def on_exit(self, close: Callable[[], object]) -> None:
        """Register a callback to run before the controller ends, in reverse order of registration; for clients."""
        self._on_exit.append(close)

    def fault(self, name: str, /, **arguments: object) -> dict[str, Any]:
        """Call a hook of the fault port; `docs/reference/ur_controller.md` lists them.

        Args:
            name: Name of the hook.
            arguments: Its arguments.

        Returns:
            Its answer.

        Raises:
            UserError: The hook or an argument is invalid.
            DeviceError: The controller does not answer.
        """
        assert self._client is not None, "enter the context first"
        return self._client.fault(name, **arguments)

    def state(self) -> dict[str, Any]:
        """True state of the robot: joints, modes, program, tick statistics."""
        return self.fault("state")

    def trace(self, after: int = -1) -> Trace:
        """The arm's states in all ticks after number `after` that are still kept."""
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
                stream.close()  # the end of its input makes the child end
        try:
            child.wait(STOP_TIME)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
        self._child = None


class _Parent:
    """A service that stops the controller when the parent closes the pipe or dies."""

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
    """Run the controller described on standard input until that is closed."""
    # Signals to the whole process group are for the parent, which closes its clients before it ends this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    pipe = sys.stdin.buffer
    options, plant, setup, verbose, realtime = pickle.loads(pipe.read(int.from_bytes(pipe.read(4), "big")))

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
    controller.run(realtime)


if __name__ == "__main__":
    _child()
