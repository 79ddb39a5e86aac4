"""What every room stands on: results, observations, settings, errors, files, units."""
