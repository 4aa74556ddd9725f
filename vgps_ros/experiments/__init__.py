"""Runs of the method in this process: training, and later comparisons and benchmarks."""
