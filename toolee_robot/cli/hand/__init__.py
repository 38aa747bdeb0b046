"""Command `toolee hand`: the hand alone, without a job."""
