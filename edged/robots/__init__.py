"""Programs for the other end, in the languages of robots, PLCs and PCs, rendered from `templates`."""
