"""The ROS 2 action client: goals, links to servers, handshake, liveness."""
