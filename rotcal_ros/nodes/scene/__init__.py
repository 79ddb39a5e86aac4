"""The scene: what a cell looks like while it is calibrated, for viewers in three dimensions."""
