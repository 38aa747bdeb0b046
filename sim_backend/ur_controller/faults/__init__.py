"""The fault port of the controller stand-in: hooks that break it on purpose."""
