"""The robot of the controller stand-in: kinematics, motions, safety system, plant."""
