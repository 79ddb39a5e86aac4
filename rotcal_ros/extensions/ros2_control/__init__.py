"""A table that a controller of ros2_control moves: where to go, which way, and what it does."""
