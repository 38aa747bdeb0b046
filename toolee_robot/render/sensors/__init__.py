"""Sensor models of a colour camera and of depth cameras: time of flight, structured light, active stereo."""
