"""Research: the paper's estimator, and classical ones to compare with."""
