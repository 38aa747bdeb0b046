"""Cross-checks of the simulated station's physics against MuJoCo, and sweeps of its own parameters.

python -m tests.cross_checks        prints the complete tables of docs/concepts/physics_cross_checks.md
"""
