"""The bridge node: passes compensation tables to the machine's controller."""
