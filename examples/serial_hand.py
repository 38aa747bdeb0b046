"""A hand driver: `hal.Hand` for a hand on a serial line. The `HandModel` says which joints and fingers it has."""

from typing import Any, Self

from examples.hand_line import HandLine
from toolee_robot.errors import DeviceError, NoAnswerError, StaleDataError
from toolee_robot.hal import Clock, HandState
from toolee_robot.robots.hands import HandModel

PERIOD = 0.02  # between two questions while it moves [s]


class SerialHand:
    """`state` is asked from another thread while `close` blocks."""

    def __init__(self, port: str, model: HandModel, clock: Clock) -> None:
        self._port, self._model, self._clock = port, model, clock

    def __enter__(self) -> Self:
        self._line = HandLine(self._port, self._model)
        self._state = self._line.state(self._clock.now())[1]
        return self

    def __exit__(self, *_: Any) -> None:
        self.stop()
        self._line.close()

    @property
    def joint_names(self) -> tuple[str, ...]:
        return self._model.joints

    def state(self, max_age: float = 0.1) -> HandState:
        """Raises StaleDataError when the hand has been silent for longer than max_age [s]."""
        try:
            self._state = self._line.state(self._clock.now())[1]
        except NoAnswerError as error:
            if self._clock.now() - self._state.joints.stamp > max_age:
                raise StaleDataError(f"the hand is silent: {error}") from error
        return self._state

    def open(self, timeout: float = 5.0) -> None:
        self._move("open", timeout)

    def close(self, timeout: float = 5.0) -> None:
        self._move("closed", timeout)

    def stop(self) -> None:
        self._line.ask("hold")

    def _move(self, posture: str, timeout: float) -> None:
        self._line.ask("goal " + " ".join(f"{angle:.4f}" for angle in self._model.posture(posture)))
        end = self._clock.now() + timeout
        while self._line.state(self._clock.now())[0]:
            if self._clock.now() > end:
                self.stop()
                raise DeviceError(f"the hand did not finish within {timeout:.1f} s; it keeps what it holds")
            self._clock.sleep(PERIOD)


if __name__ == "__main__":
    print(__doc__)
