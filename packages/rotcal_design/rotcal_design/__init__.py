"""Optimal design and trade: what reaches an uncertainty, what it takes, and what nothing beats."""
