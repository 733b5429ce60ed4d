"""Any machined part as one solid: found, laid and measured by all its edges in both cameras at once."""
