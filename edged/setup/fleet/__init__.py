"""Signed releases for many cells: the repository, the client of a cell, and its gate."""
