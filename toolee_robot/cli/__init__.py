"""The command line, `toolee`; the only layer that knows whether a station is simulated."""

from toolee_robot.cli.app import main

__all__ = ["main"]
