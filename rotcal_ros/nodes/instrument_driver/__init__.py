"""Instruments of installed packages: what they have to do, and the thread that drives one."""
