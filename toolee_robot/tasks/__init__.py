"""Tasks: state machines that see a station only through the hardware abstraction."""
