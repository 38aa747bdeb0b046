"""Visual models of the simulated world, for the simulated camera."""
