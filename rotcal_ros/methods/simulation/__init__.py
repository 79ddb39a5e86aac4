"""The simulated cell: table, temperature and an instrument as plain physics."""
