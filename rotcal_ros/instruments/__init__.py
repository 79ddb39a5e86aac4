"""Instruments as they are: messages of any kind become records in SI; nothing here knows ROS."""
