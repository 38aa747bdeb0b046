"""A stand-in for a Universal Robots controller: network interfaces, URScript interpreter and arm."""
