"""What builds a station, and what only the simulation behind it knows."""
