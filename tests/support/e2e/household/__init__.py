"""The household domain in PyRoboSim's simulator: its worlds, in this process and as a ROS 2 node."""
