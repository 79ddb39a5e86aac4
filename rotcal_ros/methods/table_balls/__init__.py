"""Balls on the table, touched by the machine's own probe: the axis, and the table's motions."""
