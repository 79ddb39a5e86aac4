"""Digital calibration certificates after the schema of PTB, version 3.3.0, with units in D-SI."""
