"""Names of what a job leaves in its folder."""

RECORDING = "recording.mcap"
"""Everything that happened, for replays and other programs."""
PICTURE = "picture.png"
"""What was seen, and what came of it."""
