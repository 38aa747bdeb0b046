"""What is kept of a run: the MCAP recording, and one picture."""
