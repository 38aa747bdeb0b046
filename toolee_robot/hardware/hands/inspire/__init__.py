"""Driver of the Inspire RH56 hands (RH56DFX, RH56BFX) on RS-485, with the maker's own frames.

    with InspireHand(hand_model(config.hand), "/dev/ttyUSB0", HostClock()) as hand:
        hand.open()

`frames` are the bytes, apart from any port; `registers` the maker's register map; `line` asks and is answered;
`poller` owns the port; `grip` watches what is held; `hand` is the `hal.Hand`.

Facts are from the maker's "The dexterous hand RH56 series user manual" (V1.0.9), sections 2.2 and 2.4, as public
drivers quote it, and from measurements published by X. Tan, W. Xie and N. Correll (arXiv 2603.08988,
github.com/correlllab/rh56_controller). No code here was ever run on such a hand.
"""

from toolee_robot.hardware.hands.inspire.hand import InspireHand

__all__ = ["InspireHand"]
