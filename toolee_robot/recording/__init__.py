"""Records of a run: the MCAP recording, and one picture."""
