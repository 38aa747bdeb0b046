"""`toolee bench`, `toolee bench-servo` and `toolee bench-swing`."""
