"""ROS nodes, thin: they declare parameters, convert messages, call the core and publish."""
