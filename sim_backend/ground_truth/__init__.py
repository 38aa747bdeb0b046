"""Ground truth of the simulation, for reports and tests, never for the task."""
