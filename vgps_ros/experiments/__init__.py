"""Runs in this process: training, evaluation, and the comparison of Figure 1."""
