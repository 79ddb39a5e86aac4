"""Runs the steps on the connection that it is given."""

from alembic import context

if __name__ == "env_py":  # loaded by Alembic, and not with all modules of the package
    context.configure(connection=context.config.attributes["connection"])
    context.run_migrations()
