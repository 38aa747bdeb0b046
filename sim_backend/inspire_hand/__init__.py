"""Emulator of an Inspire RH56 hand on a pseudo-terminal, for drivers that speak the maker's frames.

    with InspireEmulator() as emulator:
        emulator.hold(400)             # a handle, met by the fingers at 400 of 1000
        serial.Serial(emulator.port)   # a driver's side

It is written from the maker's frames and from measurements, not from the project's driver, with which it shares no
code. What it does is

- published (the maker's manual V1.0.9, sections 2.2 and 2.4): frames and checksum, register addresses and sizes, order
  of the motors, 0.8 s for the whole range at speed 1000, targets of -1, force thresholds, bits of ERROR, values of
  STATUS, the second frame after SAVE and after the calibration of the force sensors;
- measured (arXiv 2603.08988 and its repository): 6.6 ms for a read of 12 bytes, 66 ms from a command to its motion, the
  overshoot of the force threshold that follows from it (by its order), a stuck finger that reports its position as
  reached, states of 255 before the first command;
- assumed: the stiffness of what is held, temperatures and currents, 0.5 s until a blocked motor counts as stalled, that
  a motor at its force threshold stands until the next command, that a motor with a fault does not move, that heat is
  not cleared by CLEAR_ERROR, silence after a request that is damaged or not for this hand, a result of 0 for a write to
  what cannot be written.
"""

from toolee_robot.sim_backend.inspire_hand.emulator import InspireEmulator, ModbusEmulator
from toolee_robot.sim_backend.inspire_hand.hand import Hand

__all__ = ["Hand", "InspireEmulator", "ModbusEmulator"]
