"""The motors' efforts of a hand that somebody else moves, for a lab that measures what they mean."""

from __future__ import annotations

import time
from collections.abc import Generator

from toolee_robot.devices.hands.shadow.line import HandLine
from toolee_robot.devices.hands.shadow.reading import Reading
from toolee_robot.errors import NoAnswerError
from toolee_robot.frames import Array
from toolee_robot.hal import Clock

SILENCE = 0.5
"""Longest time without a reading [s]."""


def read_efforts(url: str, clock: Clock) -> Generator[Array]:
    """Read the efforts as they come. Nothing is moved.

    Args:
        url: Address of the rosbridge, such as `ws://127.0.0.1:9090`.
        clock: Clock of the station, the host's.

    Yields:
        Effort of each motor in the order of `MOTORS`, without its sign, (20,) [in the hand's unit].

    Raises:
        ConfigError: It is no such address.
        NoAnswerError: Nobody answers there, or the hand falls silent.
        ProtocolError: What answers is no right Shadow Hand.
    """
    with HandLine(url, clock) as line:
        told, heard = line.find(), time.monotonic()
        number = 1
        while True:
            yield Reading.of(told, number).forces
            while True:
                try:
                    told = line.read()
                except NoAnswerError as error:
                    if error.code != "no_answer.hand_silent" or time.monotonic() - heard > SILENCE:
                        raise
                else:
                    break
            number, heard = number + 1, time.monotonic()
