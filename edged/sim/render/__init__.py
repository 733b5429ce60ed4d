"""Scene descriptions and their rendering."""
