"""Controllers behind a network: the store of their tables over OPC UA and ADS."""
