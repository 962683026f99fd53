"""Tasks over ROS 2: the actions, services and topics of `pnm serve`."""
