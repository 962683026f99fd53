"""Several hosts on one machine: their network, the robots, nodes and databases on them, and what is done to them."""
