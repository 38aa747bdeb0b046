"""The simulated world in a process of its own, behind a controller stand-in."""
