"""The planner: carries out one calibration goal, from the preflight check to the result."""
