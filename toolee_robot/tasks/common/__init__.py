"""Components that tasks share: looking, moving, watching the hand, stages, observers."""
