"""Driver of the PSYONIC Ability Hand on a UART or RS-485, with the maker's extended API and PPP byte stuffing.

    with AbilityHand(hand_model(config.hand), "/dev/ttyUSB0", HostClock()) as hand:
        hand.open()

`frames` are the bytes, apart from any port; `replies` what the hand says in them; `line` sends a command and takes the
replies; `touch` turns the pads' counts into newtons; `hand` is the `hal.Hand`.

Facts are from the maker's "Ability Hand Interface Control Document" (ICD; github.com/psyonicinc/ability-hand-api, MIT),
sections 3.1 to 3.5, and from frames that the maker recorded for its own tests in the same repository. No code here was
ever run on such a hand.
"""

from toolee_robot.devices.hands.ability.hand import AbilityHand

__all__ = ["AbilityHand"]
