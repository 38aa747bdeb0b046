"""Checks of a station before the first motion. Each finding states its remedy; nothing is moved."""
