"""Records of a run: the MCAP recording, and one picture."""

RECORDING = "recording.mcap"
"""Name of the file that holds everything that happened, for replays and other programs."""
PICTURE = "picture.png"
"""Name of the picture: what was seen, and what came of it."""
