"""What the controller measures: joints and forces, with the errors of a profile."""
