"""Research: ablations of the design, and ToolEENet's estimator as the reference."""
