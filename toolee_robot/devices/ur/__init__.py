"""The driver of a UR10 or UR10e, and the checks of its controller."""
