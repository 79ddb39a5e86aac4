"""The correction of a rotary axis, and one writer per controller."""
