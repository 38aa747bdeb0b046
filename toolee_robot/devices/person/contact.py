"""A contact on one or two digital inputs, debounced, and in doubt neither made nor broken."""

from __future__ import annotations

DEBOUNCE = 0.05
"""Time for which every reading must agree before a contact counts as made or broken [s]; contacts bounce for some
10 ms."""
DISCREPANCY = 0.5
"""Longest time for which two antivalent contacts may agree with each other, while they change [s]."""


class Contact:
    """The debounced state of a contact.

    With two inputs the contacts are antivalent: one is high while the other is low. Both low is an unplugged cable,
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
            self.fault = f"both contacts of the {self._name} are {both}; mend it, then operate it once"
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
