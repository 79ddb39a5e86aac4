"""Is it true? ISO 230-2, comparison of results, Monte Carlo, harmonics."""
