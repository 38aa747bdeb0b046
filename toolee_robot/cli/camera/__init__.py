"""`toolee camera`."""
