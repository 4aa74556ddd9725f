"""Differential dynamic programming in the iterative LQR form of section 4."""
