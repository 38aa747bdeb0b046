"""Camera of the protocol of the paper."""

from __future__ import annotations

FULL_WIDTH, FULL_HEIGHT = 960, 540
"""Size [px] of the full image; a window of it is rendered."""
FOCAL = 480.0
"""Focal length [px]: a field of view of about 90 degrees."""
CIRCLE = 30.0
"""Radius [px] of the EE mask about the EE origin: 2.6 to 6.1 cm at depths of 0.42 to 0.98 m."""
