"""Whether a cell measures what it says, in its own place: acceptance, and studies of a size."""
