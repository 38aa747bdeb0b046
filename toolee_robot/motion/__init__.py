"""What every arm does with a trajectory: checks before it starts, stops on its path."""
