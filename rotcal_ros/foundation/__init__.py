"""What all packages build on: results, observations, settings, errors, files, units."""
