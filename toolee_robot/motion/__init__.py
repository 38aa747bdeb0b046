"""Checks and stops of trajectories that every arm driver shares."""
