"""Emulator of a PSYONIC Ability Hand on a pseudo-terminal, for drivers that speak the maker's extended API.

    with AbilityEmulator() as emulator:
        emulator.hold(60)              # a handle, met by the fingers at 60 deg
        serial.Serial(emulator.port)   # a driver's side

It is written from the maker's Interface Control Document (ICD) and from its recordings, not from the project's driver,
with which it shares no code; the maker's own Python client runs on it. What it does is

- published (ICD 3.1 to 3.5): frames, stuffing, checksum, headers and variants of replies, units, order and signs of the
  motors, 12-bit touch pads, that a message may be cut short, 0.3 s until the API mode ends, that read-only messages
  keep it up but do not enter it, that a finger that collides may not go on in that direction until it is told to go the
  other way, that such a command may be taken for a collision in turn, shut-down of a hot motor or of all, the bits that
  tell of both; from the maker's URDF: ranges, fastest speeds, and the rotor's gear ratio; from one recorded frame:
  what the pads say at rest;
- assumed: that the fingers open when the API mode ends (the ICD: "may be accompanied by undesired finger movements"),
  how stiff what it holds is, the force at which a finger counts as having collided, the share of the pads in it, noise
  of the pads, temperatures, currents, 1 ms until it answers, 20 ms until it moves, silence after a damaged or a longer
  message, that stuffing is switched on, how voltages and currents become speeds.

Not there: I2C, Bluetooth, fast mode, the upsampling of the rotator, the registers, slave networks.
"""

from toolee_robot.sim_backend.ability_hand.emulator import AbilityEmulator
from toolee_robot.sim_backend.ability_hand.hand import Hand

__all__ = ["AbilityEmulator", "Hand"]
