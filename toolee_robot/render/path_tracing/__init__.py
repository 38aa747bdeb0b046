"""A second renderer, Mitsuba 3: path-traced pictures to evaluate on, never to train on.

It takes geometry, poses and base colours of a scene. Light, materials, shading and the colour camera are its own, and
depth and ids come from its own rays.
"""
