"""What all nodes share: how they run, beat, hear, and are told apart."""
