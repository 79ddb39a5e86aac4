"""The node of the page: what it hears, made into sections, and what a person asks, passed on."""
