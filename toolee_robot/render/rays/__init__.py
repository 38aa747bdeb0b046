"""Rays against triangles: by embree on the processor, by Warp's trees on a GPU."""
