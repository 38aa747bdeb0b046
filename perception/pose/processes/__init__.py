"""The generative processes that a pose network may be trained for, with their samplers."""
