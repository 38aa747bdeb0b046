"""Construction of stations, and the ground truth of their simulations."""
