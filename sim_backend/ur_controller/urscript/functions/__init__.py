"""Built-in functions of URScript: language library, inputs and outputs, motion, state."""
