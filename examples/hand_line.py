"""What `serial_hand.py` speaks to its device: a line each way.

"state" -> 1 or 0 (it moves), joint angles [rad], a force per finger [N]. "goal ANGLES" -> "ok". "hold" -> "ok".
"""

from threading import Lock

import numpy as np
import serial

from toolee_robot.errors import NoAnswerError
from toolee_robot.hal import HandState
from toolee_robot.robots.hands import HandModel
from toolee_robot.types import JointState

ANSWER_TIME, TOUCH = 0.1, 0.5  # [s], force that counts as a touch [N]


class HandLine:
    """The hand at a serial port. It may be asked from several threads."""

    def __init__(self, port: str, model: HandModel) -> None:
        self._serial, self._model = serial.Serial(port, 115200, timeout=ANSWER_TIME), model
        self._lock = Lock()

    def ask(self, line: str) -> list[str]:
        """The words of the answer. Raises NoAnswerError when there is none within ANSWER_TIME."""
        with self._lock:
            self._serial.reset_input_buffer()  # an answer that came too late is not this one's
            self._serial.write(f"{line}\n".encode())
            words = self._serial.readline().decode().split()
        if not words:
            raise NoAnswerError(f"{self._serial.port} does not answer {line.split()[0]!r}: check cable and power")
        return words

    def state(self, stamp: float) -> tuple[bool, HandState]:
        """Whether it moves, and its state, stamped [s]."""
        joint_count = len(self._model.joints)
        moves, *numbers = map(float, self.ask("state"))
        angles, forces = np.array(numbers[:joint_count]), numbers[joint_count:]
        opposing, *others = (force > TOUCH for force in forces)  # in the order of the model's fingers
        fingers = dict(zip((finger.name for finger in self._model.fingers), forces, strict=True))
        joints = JointState(angles, np.zeros_like(angles), stamp)
        return bool(moves), HandState(joints, fingers, holding=opposing and sum(others) >= 2)

    def close(self) -> None:
        """Release the port."""
        self._serial.close()


if __name__ == "__main__":
    print(__doc__)
