"""Research: the training of the paper's estimator."""
