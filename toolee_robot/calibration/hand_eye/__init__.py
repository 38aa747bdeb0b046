"""The fixed camera calibrated to the robot: closed form, joint refinement, checks."""
