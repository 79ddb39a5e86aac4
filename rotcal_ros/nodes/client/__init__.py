"""Clients of the planner: for Python scripts, and for programs without ROS."""
