"""From an RGB-D image to the instance masks of the tools' end effectors, and the detector's training."""
