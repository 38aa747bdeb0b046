"""Driver of the Inspire RH56 hands: on RS-485 (RH56DFX, RH56BFX) with the maker's frames, or on Modbus-TCP (RH56DFTP).

    with InspireHand(hand_model(config.hand), "/dev/ttyUSB0", HostClock()) as hand:   # or "tcp://192.168.11.210:6000"
        hand.open()

`registers` is the maker's register map, `line` asks and is answered; `frames` are RS-485's bytes, apart from any port,
`modbus` Modbus-TCP's, `serial_line` and `modbus_line` the two wires, `tcp_port` a connection; `hand` is the `hal.Hand`.

Facts are from the maker's "The dexterous hand RH56 series user manual" (V1.0.9), sections 2.2 and 2.4, as public
drivers quote it, and from measurements published by X. Tan, W. Xie and N. Correll (arXiv 2603.08988,
github.com/correlllab/rh56_controller). Those of Modbus-TCP are from "The dexterous hand RH56DFTP user manual"
(PRJ-02-TS-U-010, V1.0.0), section 2.6, as the package inspire_rh56dftp (0.1.0) quotes it: the same registers at the
same addresses, which count bytes; port 6000. Numbers are big-endian, as that package and inspire_sdkpy
(github.com/laurent-19/inspire_hand_ws) read them. Assumed, as inspire_sdkpy takes it: of ERROR, STATUS and TEMP, two
bytes in a register, the first one is the high byte. No code here was ever run on such a hand.
"""

from toolee_robot.devices.hands.inspire.hand import InspireHand

__all__ = ["InspireHand"]
