"""The experiments behind the design: ablations, and the named reference ToolEENet."""
