"""Watches of the hand's grip, whose first doubt stops the arm, and of the person's inputs, which are proven first."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Self

from toolee_robot.control.supervisor_checks import Watcher
from toolee_robot.errors import DeviceError, GripError, PersonNearError
from toolee_robot.frames import Array
from toolee_robot.hal import Clock, Hand, HandState, Person

GRIP_PERIOD = 0.02
"""Polling period [s]; a hand on a serial line answers some 100 times per second."""
HOLDS_FOR = 0.2
"""Time for which the hand must report its grip without interruption after a doubt [s]: 10 successive readings."""
ASKED_FOR = 1.0
"""Longest time for which the hand is asked after a doubt; without a steady answer the tool counts as lost [s]."""

MAX_DOUBTS = 3
"""Number of motions between two strikes, or of one weighing, that a doubt may interrupt before a person is asked."""


def _check_fault(state: HandState) -> None:
    if state.fault:
        raise DeviceError(f"the hand reports a fault ({state.fault}): no further strike. Check the hand")


def check_held(hand: Hand, clock: Clock) -> None:
    """Check at standstill that the hand holds the tool; one bad reading is not believed, nor is a grip that flickers.

    Args:
        hand: The hand.
        clock: Clock of the station.

    Raises:
        GripError: The hand has lost the tool: over ASKED_FOR it never reported its grip for HOLDS_FOR.
        DeviceError: The hand reports a fault, or does not answer.
    """
    end = clock.now() + ASKED_FOR
    held_since: float | None = None
    doubted = False
    while (now := clock.now()) <= end:
        state = hand.state()
        if state.holding:
            held_since = now if held_since is None else held_since
            if not doubted or now - held_since >= HOLDS_FOR - 1e-9:
                _check_fault(state)
                return
        else:
            held_since, doubted = None, True
        clock.sleep(GRIP_PERIOD)
    raise GripError("the hand has lost the tool. Pick it up and start again")


class HandWatch:
    """Context in which the arm is stopped at the first reading without a grip, or with a fault.

    Standing still is safe, and a hammer that leaves the hand in a strike is not: a doubt costs nothing but time.

    Args:
        hand: The hand that holds the tool.
        stop: Stops the arm; called from another thread.

    Attributes:
        course: The joints' positions, (n,) [rad], by time [s], as they were read.
        error: The error that stopped the arm, or None.
        doubted: Whether a single reading without a grip stopped the arm; `check_held` finds out whether it was true.
    """

    def __init__(self, hand: Hand, stop: Callable[[], None]) -> None:
        self.course: list[tuple[float, Array]] = []
        self.error: Exception | None = None
        self.doubted = False
        self._hand = hand
        self._watcher = Watcher(self._reason_to_stop, stop, "the hand does not answer", GRIP_PERIOD)

    def __enter__(self) -> Self:
        self._watcher.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self._watcher.__exit__(*error)
        if self.error is None and not self.doubted and self._watcher.reason:
            self.error = DeviceError(self._watcher.reason)

    def _reason_to_stop(self) -> str:
        try:
            state = self._hand.state()
            if not self.course or state.joints.stamp > self.course[-1][0]:
                self.course.append((state.joints.stamp, state.joints.q))
            if not state.holding:
                self.doubted = True
                return "the hand does not report its grip"
            _check_fault(state)
        except DeviceError as error:
            self.error = error
            return str(error)
        return ""


INPUTS_PERIOD = 0.05
"""Polling period of the inputs while a question is open [s]."""
MISSING = {
    ("zone", True): "nobody was seen within reach during the handover",
    ("zone", False): "the zone was never seen empty",
    ("switch", True): "the hold-to-run switch was never seen held",
    ("switch", False): "the hold-to-run switch was never seen released",
}
"""What an input has not shown yet, by the input and the reading that is missing."""


class PersonProof:
    """A `hal.Person` around another one, which reports an empty zone only once both inputs have been seen to change.

    A door contact that is bridged, a plug that was pulled and a driver that always answers `False` look like an empty
    zone. A handover makes every input change: somebody is within reach and then not, and the hold-to-run switch is
    released and then held. Until each of the four readings was seen, `zone_occupied` refuses to answer "no", and with
    it the supervisor UNATTENDED mode. Simulated persons are no exception.

    Args:
        person: The person to prove.
    """

    def __init__(self, person: Person) -> None:
        self._person = person
        self._missing = dict(MISSING)

    @property
    def missing(self) -> tuple[str, ...]:
        """What the inputs have not shown yet; empty once both are proven."""
        return tuple(self._missing.values())

    def request_handover(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`."""
        return self._ask(self._person.request_handover, prompt, timeout)

    def release(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`."""
        return self._ask(self._person.release, prompt, timeout)

    def take_tool(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`."""
        return self._ask(self._person.take_tool, prompt, timeout)

    def confirm_swing(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`."""
        return self._ask(self._person.confirm_swing, prompt, timeout)

    def confirm_inspection(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`."""
        return self._ask(self._person.confirm_inspection, prompt, timeout)

    def hold_switch(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`."""
        return self._ask(self._person.hold_switch, prompt, timeout)

    def zone_occupied(self) -> bool:
        """See `hal.Person`.

        Raises:
            PersonNearError: Nobody seems to be inside, but the inputs are not proven.
        """
        occupied = self._read("zone", self._person.zone_occupied)
        if not occupied and self._missing:
            raise PersonNearError(
                f"the person's inputs cannot be trusted yet ({'; '.join(self.missing)}): no fast motion. Check for "
                "a stuck, bridged or unplugged input"
            )
        return occupied

    def hold_to_run_held(self) -> bool:
        """See `hal.Person`."""
        return self._read("switch", self._person.hold_to_run_held)

    def readings_certain(self) -> bool:
        """See `hal.Person`."""
        return self._person.readings_certain()

    def _ask(self, question: Callable[[str, float], bool], prompt: str, timeout: float) -> bool:
        self._look()
        with Watcher(self._look, lambda: None, "", INPUTS_PERIOD):
            answer = question(prompt, timeout)
        self._look()
        return answer

    def _look(self) -> str:
        try:
            self._read("zone", self._person.zone_occupied)
            self._read("switch", self._person.hold_to_run_held)
        except DeviceError:
            pass  # an input that cannot be read proves nothing
        return ""

    def _read(self, what: str, read: Callable[[], bool]) -> bool:
        """Read an input; what was certain before and after it counts as seen."""
        certain = self._person.readings_certain()
        reading = read()
        if certain and self._person.readings_certain():
            self._missing.pop((what, reading), None)
        return reading
