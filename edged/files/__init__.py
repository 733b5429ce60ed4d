"""File formats: written atomically, versioned, and validated strictly when read."""
