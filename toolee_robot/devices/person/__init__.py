"""The person at a real station, known by digital inputs."""
