"""Motions of a bring-up: slow, one at a time, each planned under caps that the supervisor enforces as limits."""
