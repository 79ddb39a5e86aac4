"""Kinds of controllers beside the core, each in a module of its name, found by its entry point."""
