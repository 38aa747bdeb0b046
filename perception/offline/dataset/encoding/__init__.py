"""How a data set's files are encoded: PNG, run lengths of masks, checksums."""
