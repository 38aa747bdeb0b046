"""A person device must be seen to change before anything fast relies on it."""

from __future__ import annotations

from collections.abc import Callable

from toolee_robot.control.supervisor_checks import Watcher
from toolee_robot.errors import DeviceError, PersonNearError
from toolee_robot.hal import Person

PERIOD = 0.05
"""Polling period of the inputs while a question is open [s]."""
MISSING = {
    ("zone", True): "nobody was ever seen within reach, although a tool was handed over there",
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
            PersonNearError: Nobody seems to be inside, but the inputs are not proven; code
                `person_near.inputs_not_proven`.
        """
        occupied = self._read("zone", self._person.zone_occupied)
        if not occupied and self._missing:
            raise PersonNearError(
                f"the person's inputs are not to be believed yet ({'; '.join(self.missing)}): no fast motion; look "
                "for a stuck, bridged or unplugged input",
                code="person_near.inputs_not_proven",
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
        with Watcher(self._look, lambda: None, "", PERIOD):
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
