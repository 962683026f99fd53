"""Knowledge over ROS 2: services for servers, knowledge bases of other processes, people on topics."""
