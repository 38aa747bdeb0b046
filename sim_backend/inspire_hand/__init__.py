"""Emulator of an Inspire RH56 hand, for drivers that speak the maker's frames or Modbus-TCP.

    with InspireEmulator() as emulator:
        emulator.hold(400)             # a handle, met by the fingers at 400 of 1000
        serial.Serial(emulator.port)   # a driver's side
    with ModbusEmulator(("127.0.0.1", 6000)) as emulator:   # the same hand with Ethernet
        ...

`hand` is the hand, on whatever wire; `requests` is RS-485, `modbus` Modbus-TCP. They are written from the maker's
frames, the Modbus specification and measurements, not from the project's driver, with which they share no code. What
the hand does is

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

Of Modbus-TCP is

- published (the RH56DFTP's manual PRJ-02-TS-U-010, V1.0.0, section 2.6, as the package inspire_rh56dftp 0.1.0 quotes
  it): port 6000, functions 03 and 16, addresses, which count bytes; exceptions are the specification's;
- seen by the author of inspire_rh56dftp: big-endian numbers, transaction identifiers that are off by one
  (`ModbusServer.shift`), a connection that is ended if it is made less than 0.3 s after the last one, there sometimes,
  here always;
- assumed: of two single bytes the first one is the high byte, but a single one is written in the low byte, with
  function 06 (as github.com/laurent-19/inspire_hand_ws has it); 2 ms for a reply; exceptions 2 and 3 for what cannot be
  read or written, silence for another unit, one connection at a time, no second frame after SAVE and calibration.
"""

from toolee_robot.sim_backend.inspire_hand.emulator import InspireEmulator, ModbusEmulator
from toolee_robot.sim_backend.inspire_hand.hand import Hand

__all__ = ["Hand", "InspireEmulator", "ModbusEmulator"]
