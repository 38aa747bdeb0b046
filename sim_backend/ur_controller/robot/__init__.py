"""The arm behind the controller stand-in: kinematics, motions, safety system, plant."""
