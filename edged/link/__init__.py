"""The link between the cell's process and the page's: one versioned schema, and two ends."""
