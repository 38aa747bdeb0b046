"""The command line, `toolee`: what the person sees. The only layer that may know that a station is simulated."""

from toolee_robot.cli.app import main

__all__ = ["main"]
