"""Nodes that play the table and the instruments: the simulated cell and LinuxCNC."""
