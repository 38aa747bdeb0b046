"""Checks that a data set is whole and agrees with itself."""
