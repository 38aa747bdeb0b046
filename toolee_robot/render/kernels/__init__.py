"""Warp kernels that run once per pixel or ray, on the CPU or on a GPU.

Warp compiles them on their first launch on a device (some seconds) and caches them for later processes.
Vectors of N rays are stored as (3, N), because Embree's packets are filled from rows.
"""
