"""The person at the station, known by the robot's digital inputs: a guarded door and a hold-to-run switch."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any, Self

from toolee_robot.errors import ConfigError, DeviceError
from toolee_robot.findings import Finding, fail, ok
from toolee_robot.hal import CLEAR_TIME, Arm, Clock
from toolee_robot.station import PersonConfig, StationConfig

DEBOUNCE = 0.05
"""Time for which every reading must agree before a contact counts as made or broken [s]; contacts bounce for some
10 ms."""
DISCREPANCY = 0.5
"""Longest time for which two complementary contacts may agree with each other, while they change [s]."""


class Contact:
    """The debounced state of a contact.

    With two inputs the contacts are complementary: one is high while the other is low. Both low is an unplugged cable,
    both high a short circuit or a contact that is stuck; after DISCREPANCY either is a fault, until the contact is seen
    broken on both inputs. With one input a contact that is stuck high cannot be told from one that is made: only a
    change proves it.

    Args:
        name: What it is, for messages.
        made_input: Number of the input that is high while the contact is made.
        broken_input: Number of the input that is high while it is broken; None for a single contact.
        max_gap: Longest time between two readings that count as successive [s].

    Attributes:
        fault: Description of the contacts' fault; empty for none.
    """

    def __init__(self, name: str, made_input: int, broken_input: int | None, max_gap: float) -> None:
        self.fault = ""
        self._name, self._made_input, self._broken_input = name, made_input, broken_input
        self._max_gap = max_gap
        self._reading: bool | None = None
        self._since = self._last = -1.0
        self._made = self._broken = False

    @property
    def made(self) -> bool:
        """Whether the contact has surely been made for DEBOUNCE."""
        return self._made

    @property
    def broken(self) -> bool:
        """Whether the contact has surely been broken for DEBOUNCE."""
        return self._broken

    def update(self, bits: int, now: float) -> None:
        """Take a reading of the inputs. A single one ends `made` at once; only DEBOUNCE of them begin it.

        Args:
            bits: The digital inputs, bit n for input n.
            now: Time of the reading [s].
        """
        reading = self._read(bits)
        if reading != self._reading or not 0.0 <= now - self._last <= self._max_gap:
            self._reading, self._since = reading, now
        self._last = now
        steady = now - self._since
        self._broken = reading is False and steady >= DEBOUNCE
        if reading is None and steady >= DISCREPANCY:
            both = "high: one is stuck or short-circuited" if self._bit(bits, self._made_input) else "low: unplugged"
            self.fault = f"both contacts of the {self._name} are {both}. Repair it, then operate it once"
        elif self._broken:
            self.fault = ""
        self._made = reading is True and steady >= DEBOUNCE and not self.fault

    def lose(self) -> None:
        """Note that the inputs cannot be read: the contact is neither made nor broken."""
        self._reading, self._made, self._broken = None, False, False
        self._last = -1.0

    def _read(self, bits: int) -> bool | None:
        made = self._bit(bits, self._made_input)
        if self._broken_input is None:
            return made
        broken = self._bit(bits, self._broken_input)
        return None if made == broken else made

    @staticmethod
    def _bit(bits: int, number: int) -> bool:
        return bool(bits >> number & 1)


PERIOD = 0.01
"""Polling period of the inputs [s]."""
MAX_AGE = 0.1
"""Age of the newest reading above which the zone counts as occupied and the switch as released [s]."""
CONFIRM = "To confirm, release the hold-to-run switch, press it, and release it again."
"""What every question ends with."""


class DigitalInputPerson:
    """A `hal.Person` on a guarded door and a hold-to-run switch; use it in its `with` block.

    The zone is empty only while the door is closed for certain, and the switch held only while it is pressed for
    certain: an unplugged cable, contacts that disagree, inputs that cannot be read or are too old, and a person device
    that was closed all read as occupied and not held. A question is confirmed by a press of the switch from release to
    release within its time, which a stuck or tied switch cannot give. `release` takes it with the door closed only:
    mount the switch so that who presses it then stands outside and sees the whole zone.

    Args:
        config: The inputs.
        read: Returns the robot's digital inputs, bit n for input n; its argument is the largest age [s], and it raises
            DeviceError for an older reading. Called from a thread.
        clock: The station's clock, on the host's time.
        tell: Shows a prompt to the person.
    """

    def __init__(
        self, config: PersonConfig, read: Callable[[float], int], clock: Clock, tell: Callable[[str], object]
    ) -> None:
        self._door = Contact("door", config.door_closed_input, config.door_open_input, MAX_AGE)
        self._switch = Contact(
            "hold-to-run switch", config.hold_to_run_input, config.hold_to_run_released_input, MAX_AGE
        )
        self._read, self._clock, self._tell = read, clock, tell
        self._stamp: float | None = None
        self._lock = threading.Lock()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="digital inputs", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: Any) -> None:
        self._over.set()
        self._thread.join()

    @property
    def faults(self) -> tuple[str, ...]:
        """Faults of the contacts' wiring; empty for none."""
        with self._lock:
            return tuple(contact.fault for contact in (self._door, self._switch) if contact.fault)

    def request_handover(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`."""
        return self._confirmed(prompt, timeout)

    def release(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`: close the door, confirm from outside; a door that opens again voids the confirmation."""
        self._tell(f"{prompt} Leave, close the door. {CONFIRM}")
        end = self._clock.now() + timeout
        while self._wait(lambda: not self.zone_occupied(), end):
            if self._pressed(end, self.zone_occupied) and self._stays_clear(end):
                return True
        return False

    def take_tool(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`."""
        return self._confirmed(prompt, timeout)

    def confirm_swing(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`."""
        return self._confirmed(prompt, timeout)

    def confirm_inspection(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`."""
        return self._confirmed(prompt, timeout)

    def hold_switch(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`."""
        self._tell(prompt)
        end = self._clock.now() + timeout
        return self._wait(self._switch_released, end) and self._wait(self.hold_to_run_held, end)

    def door_closed(self) -> bool | None:
        """Whether the door is closed; None if that is not known for certain."""
        return self._made(self._door)

    def switch_pressed(self) -> bool | None:
        """Whether the hold-to-run switch is pressed; None if that is not known for certain."""
        return self._made(self._switch)

    def zone_occupied(self) -> bool:
        """Whether the door is open, or not closed for certain."""
        return self.door_closed() is not True

    def hold_to_run_held(self) -> bool:
        """Whether the hold-to-run switch is pressed for certain."""
        return self.switch_pressed() is True

    def readings_certain(self) -> bool:
        """Whether both contacts have been read and have settled; see `hal.Person`."""
        with self._lock:
            return self._fresh() and all(contact.made or contact.broken for contact in (self._door, self._switch))

    def _made(self, contact: Contact) -> bool | None:
        with self._lock:
            known = self._fresh() and (contact.made or contact.broken)
            return contact.made if known else None

    def _switch_released(self) -> bool:
        return self.switch_pressed() is False

    def _confirmed(self, prompt: str, timeout: float) -> bool:
        self._tell(f"{prompt} {CONFIRM}")
        return self._pressed(self._clock.now() + timeout)

    def _pressed(self, end: float, given_up: Callable[[], bool] = lambda: False) -> bool:
        """Whether the switch was released, pressed and released before `end` [s], and nothing made it void."""
        return all(
            self._wait(condition, end, given_up)
            for condition in (self._switch_released, self.hold_to_run_held, self._switch_released)
        )

    def _stays_clear(self, end: float) -> bool:
        """Whether the zone is empty from now on for CLEAR_TIME, before `end` [s]."""
        due = self._clock.now() + CLEAR_TIME
        return self._wait(lambda: self._clock.now() >= due, end, self.zone_occupied)

    def _wait(self, condition: Callable[[], bool], end: float, given_up: Callable[[], bool] = lambda: False) -> bool:
        while self._clock.now() <= end and not given_up():
            if condition():
                return True
            self._clock.sleep(PERIOD)
        return False

    def _fresh(self) -> bool:
        return self._stamp is not None and self._clock.now() - self._stamp <= MAX_AGE

    def _run(self) -> None:
        while not self._over.wait(PERIOD):
            now = self._clock.now()
            try:
                bits = self._read(MAX_AGE)
            except DeviceError:
                bits = None
            with self._lock:
                if bits is None:
                    self._stamp = None
                    self._door.lose()
                    self._switch.lose()
                else:
                    self._stamp = now
                    self._door.update(bits, now)
                    self._switch.update(bits, now)


def open_person(config: StationConfig, arm: Arm, clock: Clock, tell: Callable[[str], object]) -> DigitalInputPerson:
    """Make the person of a station from its station file, on the arm's digital inputs.

    Args:
        config: Configuration of the station.
        arm: The arm, entered before the person and left after it.
        clock: The station's clock, on the host's time.
        tell: Shows a prompt to the person.

    Returns:
        The person, not yet entered.

    Raises:
        ConfigError: The station file names no inputs.
    """
    return DigitalInputPerson(check_wired(config), lambda age: arm.state(age).digital_inputs, clock, tell)


def check_wired(config: StationConfig) -> PersonConfig:
    """Look up the inputs of a station's person.

    Args:
        config: Configuration of the station.

    Returns:
        The inputs.

    Raises:
        ConfigError: The station file names none.
    """
    if config.person is None:
        raise ConfigError(
            "the station file has no `person`. Enter the inputs of door and hold-to-run switch; without them "
            "nothing fast moves"
        )
    return config.person


LOOK_PERIOD = 0.02
"""Polling period while a person is asked for a change [s]."""
SETTLING = 0.5
"""Time in which a contact that is as it should be at the start is read so [s]; nobody is asked for it then."""


def check_inputs(
    person: DigitalInputPerson, clock: Clock, tell: Callable[[str], object], timeout: float = 30.0
) -> Iterator[Finding]:
    """Demand to see each change of door and switch once; nothing is moved.

    Args:
        person: The person at the station, inside its `with` block.
        clock: The station's clock.
        tell: Shows to the person what to do next.
        timeout: Time for each change [s].

    Yields:
        One finding for the door and one for the switch: OK, or FAIL with the change that did not come and the contact
        that is stuck or unplugged.
    """
    door = ("close the door", "open the door", "close the door again")
    switch = ("release the hold-to-run switch", "press the hold-to-run switch and hold it", "release it")
    yield _check("door", door, person.door_closed, True, person, clock, tell, timeout)
    yield _check("hold-to-run switch", switch, person.switch_pressed, False, person, clock, tell, timeout)


def _check(
    name: str,
    prompts: tuple[str, str, str],
    reading: Callable[[], bool | None],
    at_first: bool,
    person: DigitalInputPerson,
    clock: Clock,
    tell: Callable[[str], object],
    timeout: float,
) -> Finding:
    """Await `reading` as it should be at first, changed, and as at first again; None is no reading."""
    wanted = (at_first, not at_first, at_first)
    settled = _reads(reading, at_first, clock, SETTLING)
    for prompt, state in list(zip(prompts, wanted, strict=True))[int(settled) :]:
        tell(f"{prompt} (within {timeout:.0f} s)")
        if not _reads(reading, state, clock, timeout):
            remedy = "repair it, then check again; nothing fast may move until both are seen to change"
            return fail(name, _cause(name, prompt, reading(), person), remedy)
    return ok(name, "every change was seen")


def _cause(name: str, prompt: str, made: bool | None, person: DigitalInputPerson) -> str:
    """What hinders a change: its fault, no reading, or a contact that stays as it is."""
    asked = f"asked to {prompt}: "
    if fault := next((fault for fault in person.faults if name in fault), ""):
        return asked + fault.partition(";")[0]
    if made is None:
        return asked + "its inputs are unreliable: no data, or bouncing contacts"
    if made:
        return asked + "its input stays high: stuck, bridged, or another one's number"
    return asked + "its input stays low: unplugged, stuck, or another one's number"


def _reads(reading: Callable[[], bool | None], wanted: bool, clock: Clock, timeout: float) -> bool:
    end = clock.now() + timeout
    while reading() is not wanted:
        if clock.now() > end:
            return False
        clock.sleep(LOOK_PERIOD)
    return True
