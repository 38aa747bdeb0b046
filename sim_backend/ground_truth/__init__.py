"""What truly happened in the simulation, for reports and tests, never for the task."""
