"""The mask refiner, the detector's second stage: a network over a crop of each found end effector."""
