"""The virtual cell: cameras, scenes and their exact truth."""
