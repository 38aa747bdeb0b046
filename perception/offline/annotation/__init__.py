"""Annotation of photographs by hand: from clicked points to an end effector's pose with its covariance.

`toolee annotate FOLDER` collects the clicks. Modules: `clicks` (records and their file), `protocol` (which clicks a
category needs), `depth_sample` (depth at a click), `measurements` (a camera's measurements of the clicks),
`plane_models` and `axis_model` (what is fitted), `fit` (weighted least squares), `poses` (from the clicks on a frame to
poses), `frame_set` (the folder that `toolee evaluate photographs` reads), `session` (a person at work on it).
"""
