"""Pictures and figures of a data set, for looking at it."""
