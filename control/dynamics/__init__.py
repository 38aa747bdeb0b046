"""Rigid-body dynamics of the arm, and what a strike asked of it."""
