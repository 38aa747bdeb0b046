"""Rigs that faults are injected into: the driver on the controller stand-in, the simulated job, people, perception."""
