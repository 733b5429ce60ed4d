"""Client programs in the languages of robots, PLCs and PCs, rendered from `templates`."""
