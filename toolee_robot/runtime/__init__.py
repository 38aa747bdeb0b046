"""Processes, clocks, files, and the monitoring of the machine."""
