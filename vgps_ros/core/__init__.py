"""The method, free of any middleware: dynamics, DDP, marginals, policy and its fit."""
