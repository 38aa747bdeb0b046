"""Emulator of a right Shadow Dexterous Hand and of the rosbridge beside it, for drivers that speak rosbridge v2.0.

    with ShadowEmulator() as emulator:
        emulator.hold(55)                            # a handle, met by the knuckles at 55 deg
        websockets.sync.client.connect(emulator.port)   # a driver's side

It is written from the rosbridge protocol, from the maker's documentation and source code for ROS 1, and from that of
ros_controllers, not from the project's driver, with which it shares no code. What it does is

- published: the operations with their fields, that text which is no JSON is passed over in silence, errors as `status`;
  topics, types, names and rates of the messages (125, 50 and 2 Hz), their fields and values, the ranges of the joints
  and the speeds of the maker's description, that joints 1 and 2 of a finger have one motor and report its effort each,
  that a controller takes trajectories of all its joints only and drops points in the past, that an empty one stops it,
  the largest force demand of 1023, the halt of a motor above 60 deg C and by a broken bridge, the names of the flags;
- assumed: how stiff what it holds is, the gain between a position's error and the effort, friction, noise, currents,
  20 ms until a motor follows, that two coupled joints bend alike, that a halted motor lets go of its force and has
  cooled at 55 deg C, that velocities in a trajectory make no difference, the efforts' offsets, the clock's offset, how
  the hand stands when it is switched on.

Not there: services, actions, fragments, PNG and CBOR; the tactile sensors; the other modes of control.
"""

from toolee_robot.sim_backend.shadow_hand.emulator import ShadowEmulator
from toolee_robot.sim_backend.shadow_hand.hand import Hand

__all__ = ["Hand", "ShadowEmulator"]
