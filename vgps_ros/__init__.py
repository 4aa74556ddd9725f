"""Variational guided policy search on ROS 2."""

__version__ = "0.1.0"
