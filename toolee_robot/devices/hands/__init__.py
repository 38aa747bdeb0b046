"""Drivers of what the flange carries."""
