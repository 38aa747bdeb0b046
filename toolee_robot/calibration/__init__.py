"""Calibration of the fixed camera to the robot: board, detection, solution, record. No device, no motion."""
