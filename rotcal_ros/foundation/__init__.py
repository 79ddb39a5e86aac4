"""What all rooms build on: results, observations, settings, errors, files, units."""
