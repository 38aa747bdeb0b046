"""The fixed camera calibrated to the robot: closed forms, joint refinement, checks, and their benchmark."""
