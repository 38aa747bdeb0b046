"""What drivers of hands on a wire have in common: the thread that owns the wire, motions, and the grip.

`port` opens a serial port and names what goes wrong with it; `poller` reads the hand's state all the time; `motion`
waits until the motors stand; `setpoints` moves those that have no speeds of their own; `grip` watches what is held;
`driver` is the `hal.Hand` around them. The messages are each hand's own.
"""
