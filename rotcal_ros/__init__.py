"""Find and remove the errors of rotary tables: calibration core and ROS 2 nodes."""

__version__ = "0.1.0"
