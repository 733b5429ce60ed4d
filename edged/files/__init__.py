"""What is read from and written to disk: atomic, versioned, read with suspicion."""
