"""Sensor models of a colour camera and a time-of-flight depth camera."""
