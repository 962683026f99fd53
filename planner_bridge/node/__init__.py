"""`pnm serve` and `pnm simulate`: the ROS 2 nodes."""
