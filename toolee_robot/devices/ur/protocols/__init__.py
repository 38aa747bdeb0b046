"""Read-only clients of a UR controller's interfaces."""
