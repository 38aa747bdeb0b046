"""The generator of the synthetic data set: scenes, their bodies, their rendering, on one machine or several."""
