"""Ball plate, reduced three-rosette: everything that this method brings."""
