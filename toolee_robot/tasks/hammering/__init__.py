"""The hammering task."""
