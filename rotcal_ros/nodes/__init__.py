"""ROS 2 nodes, thin: they declare parameters, convert messages and call the core."""
