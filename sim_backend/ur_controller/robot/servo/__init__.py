"""The motion of `servoj`: exact, or with the lag of a real controller."""
