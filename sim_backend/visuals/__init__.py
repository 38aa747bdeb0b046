"""What the simulated camera sees of the simulated world."""
