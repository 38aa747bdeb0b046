"""What decides the pose network's design, one change at a time; see `toolee_robot.perception.ablations`."""
