"""How the database of a history comes to its present form, step by step (Alembic)."""
