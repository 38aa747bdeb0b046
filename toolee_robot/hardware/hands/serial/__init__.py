"""What drivers of hands on a serial line have in common: the port, the thread that owns it, motions, and the grip.

`port` opens and names what goes wrong with it; `poller` reads the hand's state all the time; `motion` waits until the
motors stand; `grip` watches what is held; `driver` is the `hal.Hand` around them. The bytes are each hand's own.
"""
