"""The recorder's work: hearing all topics, and keeping them."""
