"""Plots, Rerun recordings and progress on the terminal: everything that people look at."""
