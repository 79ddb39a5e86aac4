"""How the nodes hear instruments and move a table."""
