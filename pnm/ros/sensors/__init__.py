"""ROS 2 sensors: topics and services that report facts, and the state topic."""
