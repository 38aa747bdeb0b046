"""`toolee calibrate`."""
