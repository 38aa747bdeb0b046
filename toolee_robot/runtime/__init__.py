"""Processes, time, and the machine that they run on."""
