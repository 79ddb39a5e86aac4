"""The node of the page: turns messages into sections, and requests of a person into calls."""
