"""ROS 2 action servers: of goals, of simulated robots, and in Python with the knowledge of a run."""
