"""Tightening a nut with an open-ended wrench that a person hands over."""
