"""Find, align and measure any machined part as one solid, by all its edges in both cameras at once."""
