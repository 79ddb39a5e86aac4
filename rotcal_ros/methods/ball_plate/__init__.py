"""Ball plate, reduced three-rosette: everything that belongs to this method."""
