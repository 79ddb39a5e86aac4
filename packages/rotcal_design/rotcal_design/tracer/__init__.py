"""Which lengths a laser tracer needs: predicted uncertainty, optimal design, proven bound."""
