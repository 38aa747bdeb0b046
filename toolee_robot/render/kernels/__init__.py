"""What runs once for each pixel or ray, on the processor or on a GPU: Warp's kernels.

Warp compiles them on their first launch on a device (some seconds), and keeps what it has compiled for later processes.
Vectors that many rays share a component of are rows, (3, N): embree's packets are filled from them.
"""
