"""`toolee train`."""
