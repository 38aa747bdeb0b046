"""Physics of the simulated station in pybullet: bodies, contact, grip, nail and wood."""
