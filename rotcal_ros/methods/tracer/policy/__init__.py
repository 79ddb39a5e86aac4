"""Which step comes next, or why none does: policies that think while a plan is measured."""
