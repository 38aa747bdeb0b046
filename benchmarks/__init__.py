"""Measurements behind published figures, each run by hand: `python -m benchmarks.NAME --help`."""
