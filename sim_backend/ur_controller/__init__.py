"""A stand-in for a Universal Robots controller: the wire, the control script and the arm behind it."""
