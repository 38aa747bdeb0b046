"""When a stall of the machine excuses a test's failure."""

STALL_LIMIT = 0.02
"""Duration above which a stall excuses a failure, which is then tried again and reported [s]. It is below the driver's
tightest bound, 24 ms for the age of a UR10's data (three readings at 125 Hz)."""
