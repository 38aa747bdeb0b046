"""The safety system: modes and stops, the detection of collisions, and the codes of its errors."""
