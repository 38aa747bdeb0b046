"""Command line (in work)."""


def main() -> None:
    """Entry point."""
