"""The operator's page: what people see of a running calibration, in a browser, without ROS."""
