"""The calibration of a station: the board's plate on the flange, poses in front of the camera, images taken there."""
