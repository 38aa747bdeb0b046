"""`toolee bench` and `toolee bench-servo`."""
