"""Ports 30001 to 30003: messages of version, state and text, and the upload of URScript."""

from __future__ import annotations

import struct

from toolee_robot.sim_backend.ur_controller.robot.error_codes import ErrorCode
from toolee_robot.sim_backend.ur_controller.robot.safety_system import SafetyMode
from toolee_robot.sim_backend.ur_controller.robot_system import Robot
from toolee_robot.sim_backend.ur_controller.server.port import Sink
from toolee_robot.sim_backend.ur_controller.urscript.program import RuntimeState

MAX_SCRIPT = 256 << 10  # [bytes] of one program above which the client is dropped


class ScriptReader:
    """Splits a byte stream into programs: from `def` or `sec` to an `end` in column 0, or a single line."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._lines: list[str] = []
        self._size = 0

    @property
    def size(self) -> int:
        """Bytes of the incomplete program."""
        return self._size + len(self._buffer)

    def feed(self, data: bytes) -> list[str]:
        """Take received bytes.

        Args:
            data: The bytes.

        Returns:
            The programs that they complete; a single statement becomes a program of one line.
        """
        self._buffer += data
        done: list[str] = []
        *lines, rest = self._buffer.split(b"\n")
        self._buffer = bytearray(rest)
        for raw in lines:
            line = raw.decode("utf-8", "replace").rstrip("\r")
            if self._lines:
                self._lines.append(line)
                self._size += len(raw) + 1
                if line.rstrip() == "end":
                    done.append("\n".join(self._lines) + "\n")
                    self._lines, self._size = [], 0
            elif line.startswith(("def ", "sec ")):
                self._lines, self._size = [line], len(raw) + 1
            elif line.strip() and not line.lstrip().startswith("#"):
                done.append(f"def unnamed():\n  {line.strip()}\nend\n")
        return done


class ScriptSession:
    """A client's session on port 30003: takes programs, sends nothing.

    Args:
        sink: The client's connection.
        robot: The robot.
    """

    def __init__(self, sink: Sink, robot: Robot) -> None:
        self._sink, self._robot = sink, robot
        self._reader = ScriptReader()

    def feed(self, data: bytes) -> None:
        """Take received bytes and upload each complete program."""
        for source in self._reader.feed(data):
            if self._robot.model.e_series and not self._robot.safety.remote:
                self._robot.log("script ignored: the robot is in local control")
            else:
                self._robot.program.upload(source)
        if self._reader.size > MAX_SCRIPT:
            self._sink.close()

    def tick(self) -> None:
        """Nothing to do."""

    def close(self) -> None:
        """Nothing to release."""


STATE_RATE = 10.0  # [Hz]
SKIP_BACKLOG = 65536  # [bytes] unread by the client above which messages are omitted
_ROBOT_STATE, _ROBOT_MESSAGE = 16, 20
_VERSION_MESSAGE, _TEXT_MESSAGE, _ERROR_MESSAGE = 3, 0, 6
_REPORT_VIOLATION = 3  # report level of an error that stops the arm
_MODE, _JOINTS, _CARTESIAN, _KINEMATICS, _CONFIGURATION = 0, 1, 4, 5, 6
_MOVE_DEFAULTS = 1.05, 1.4, 0.25, 1.2, 0.0  # of movej [rad/s, rad/s^2] and movel [m/s, m/s^2]; radius
_MAX_ACCELERATION = 40.0  # [rad/s^2]: assumed, not published
_JOINT_RUNNING, _JOINT_OFF = 253, 239


class StateSession(ScriptSession):
    """A client's session on port 30001 or 30002: takes programs, and sends the robot's state.

    Args:
        sink: The client's connection.
        robot: The robot.
    """

    def __init__(self, sink: Sink, robot: Robot) -> None:
        super().__init__(sink, robot)
        self._calibration: tuple[int, ...] = ()
        self._seen = robot.said
        self._every = max(1, round(robot.model.rate / STATE_RATE))
        self._sink.send(version_message(robot))

    def tick(self) -> None:
        """Send state and messages at STATE_RATE."""
        robot = self._robot
        if robot.ticks % self._every or self._sink.backlog > SKIP_BACKLOG:
            return
        changed = self._calibration != robot.identity.checksum
        self._calibration = robot.identity.checksum
        self._sink.send(robot_state(robot, kinematics=changed))
        for _, said in list(robot.messages)[max(0, len(robot.messages) - (robot.said - self._seen)) :]:
            self._sink.send(error_message(robot, said) if isinstance(said, ErrorCode) else text_message(robot, said))
        self._seen = robot.said


def version_message(robot: Robot) -> bytes:
    """The robot message with project name and version of the software, the first message to a client."""
    project = b"URControl"
    major, minor, bugfix, build = robot.identity.version
    body = bytes([len(project)]) + project + struct.pack(">BBii", major & 255, minor & 255, bugfix, build)
    return _robot_message(robot, _VERSION_MESSAGE, body + b"01-01-2022, 00:00:00")


def text_message(robot: Robot, text: str) -> bytes:
    """Make a robot message with text that a program has printed.

    Args:
        robot: The robot.
        text: The text; characters outside ASCII become "?".

    Returns:
        The message, as bytes of the primary interface.
    """
    return _robot_message(robot, _TEXT_MESSAGE, text.encode("ascii", "replace"))


def error_message(robot: Robot, error: ErrorCode) -> bytes:
    """Make a robot message with an error that has stopped the arm.

    Args:
        robot: The robot.
        error: The error.

    Returns:
        The message, as bytes of the primary interface: code, argument, report level, type and value of its data (none),
        text.
    """
    body = struct.pack(">iiiII", error.code, error.argument, _REPORT_VIOLATION, 0, 0)
    return _robot_message(robot, _ERROR_MESSAGE, body + str(error).encode("ascii", "replace"))


def robot_state(robot: Robot, kinematics: bool) -> bytes:
    """The robot state message.

    Args:
        robot: The robot.
        kinematics: Whether to include the factory calibration.

    Returns:
        The message.
    """
    packages = _mode(robot) + _joints(robot) + _cartesian(robot)
    if kinematics:
        packages += _kinematics(robot) + _configuration(robot)
    return struct.pack(">iB", 5 + len(packages), _ROBOT_STATE) + packages


def _robot_message(robot: Robot, kind: int, body: bytes) -> bytes:
    head = struct.pack(">QbB", int(robot.timestamp * 1e6), -2, kind)
    return struct.pack(">iB", 5 + len(head) + len(body), _ROBOT_MESSAGE) + head + body


def _package(kind: int, body: bytes) -> bytes:
    return struct.pack(">iB", 5 + len(body), kind) + body


def _mode(robot: Robot) -> bytes:
    safety, state = robot.safety, robot.program.state
    flags = (
        True,  # a real robot is connected
        True,
        safety.powered,
        safety.emergency,
        safety.mode is SafetyMode.PROTECTIVE_STOP,
        state is RuntimeState.PLAYING,
        state is RuntimeState.PAUSED,
    )
    speed = robot.machine.speed_fraction
    return _package(
        _MODE,
        struct.pack(
            ">Q7?BBdddB", int(robot.timestamp * 1e6), *flags, max(0, int(safety.robot_mode)), 0, speed, speed, 1.0, 0
        ),
    )


def _joints(robot: Robot) -> bytes:
    reading, machine = robot.reading, robot.machine
    mode = _JOINT_RUNNING if robot.safety.powered else _JOINT_OFF
    body = b"".join(
        struct.pack(
            ">dddffffB", reading.q[j], machine.q_target[j], reading.qd[j], 0.0, 48.0, machine.temperatures[j], 0.0, mode
        )
        for j in range(6)
    )
    return _package(_JOINTS, body)


def _cartesian(robot: Robot) -> bytes:
    return _package(_CARTESIAN, struct.pack(">12d", *robot.reading.tcp_pose, *robot.machine.tcp))


def _kinematics(robot: Robot) -> bytes:
    identity = robot.identity
    numbers = (*identity.theta, *identity.a, *identity.d, *identity.alpha)
    return _package(_KINEMATICS, struct.pack(">6I24dI", *identity.checksum, *numbers, 1))


def _configuration(robot: Robot) -> bytes:
    """Limits of the joints. The defaults of moves are URScript's; arm and box are sent as zeros."""
    limits, model = robot.safety.detection.limits, robot.model
    most = [share * position for share, position in zip(limits.joint_position, model.position, strict=True)]
    body = [number for position in most for number in (-position, position)]
    body += [number for speed in model.velocity for number in (limits.joint_speed * speed, _MAX_ACCELERATION)]
    return _package(_CONFIGURATION, struct.pack(">53d4i", *body, *_MOVE_DEFAULTS, *[0.0] * 24, *[0] * 4))
