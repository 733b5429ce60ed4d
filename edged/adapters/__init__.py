"""One module for each foreign protocol; each translates its vendor's errors and units."""
