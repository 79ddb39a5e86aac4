"""The planner's work: one goal, from preflight to result."""
