"""What a colour camera and a time-of-flight depth camera make of an ideal image."""
