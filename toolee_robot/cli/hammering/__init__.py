"""`toolee hammer`."""
