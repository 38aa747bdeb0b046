"""What the commands do, as functions: they take a frozen record, print nothing, and return what came of it."""
