"""Sessions: the folder of one calibration, its processes, and what it leaves behind."""
