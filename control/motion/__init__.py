"""Checks and stops of trajectories that every arm driver shares, and the force of a guarded touch."""
