"""ROS 2 nodes: each declares, converts, calls the core and publishes."""
