"""The ROS 2 node: its thread, messages, publishers, services, parameters, life cycle."""
