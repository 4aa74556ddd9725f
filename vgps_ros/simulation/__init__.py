"""MuJoCo models as discrete dynamics x' = f(x, u): rollouts, derivatives, names of joints."""
