"""The ports of the controller stand-in: RTDE, dashboard, primary and secondary interfaces."""
