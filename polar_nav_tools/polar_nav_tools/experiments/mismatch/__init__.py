"""What the filter does when the world is not its own model: faults, runs, judgement, one table."""
