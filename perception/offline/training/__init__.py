"""Shared by all trainings: several GPUs, the training loop, logs, scenes read as they appear."""
