"""Files of policies, trajectory distributions and checkpoints, which can run no code."""
