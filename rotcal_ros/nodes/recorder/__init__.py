"""The recorder node: writes every topic of the cell into the bag of the session."""
