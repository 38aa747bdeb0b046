"""Driver of the right Shadow Dexterous Hand, by the rosbridge of the computer that runs the maker's ROS software.

    with ShadowHand(hand_model(config.hand), "ws://127.0.0.1:9090", config.hand.efforts, HostClock()) as hand:
        hand.open()

`rosbridge` are the operations of the rosbridge protocol as text, apart from any connection; `messages` the ROS messages
in them; `motors` what the hand says of its motors; `connection` the websocket; `freshness` tells new readings from old
ones; `acknowledgement` tells whether a command has arrived; `line` puts these together; `reading` is what they say of
the whole hand; `hand` is the `hal.Hand`.

Facts are from the rosbridge v2.0 protocol (RobotWebTools/rosbridge_suite, branch ros1, ROSBRIDGE_PROTOCOL.md), from the
maker's documentation ("Shadow Dexterous Hand", user guide, *Command Line Interface*, *Firmware*, *Ranges*), and from
its source code (shadow-robot/sr-ros-interface-ethercat, sr_core, sr_common, sr_interface), for ROS 1. No code here was
ever run on such a hand.

`roslibpy` is not used: it connects anew and subscribes anew by itself, logs and drops what it cannot decode, and its
event loop starts once in a process, so that neither a lost hand nor a damaged message would reach the job.
"""

from toolee_robot.devices.hands.shadow.hand import ShadowHand

__all__ = ["ShadowHand"]
