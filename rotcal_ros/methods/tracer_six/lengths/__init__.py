"""The algebra of lengths that stations of several places share: kept from before the engine."""
