"""How fast vgps_ros is, as ratios to peers and to floors that are measured in the same run."""
