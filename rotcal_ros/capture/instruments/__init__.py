"""Messages of instruments, of any type and unit, become records in SI, without ROS."""
