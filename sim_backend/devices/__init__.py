"""The simulated devices behind the hardware abstraction: arm, hand, camera, operator, clock."""
