"""The fault port of the controller stand-in: hooks that inject faults."""
