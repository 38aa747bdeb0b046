"""The servo process, which alone talks to the robot in its cycles, and the task's side of it."""
