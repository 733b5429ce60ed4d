"""The link between the process of the cell and that of the page: one versioned schema, and two ends."""
