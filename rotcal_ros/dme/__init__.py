"""I++ DME (VDMA 8722): a measuring machine with its rotary table over one TCP session."""
