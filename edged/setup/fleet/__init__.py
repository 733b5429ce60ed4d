"""Signed releases for many cells: a repository in a folder, what a cell takes of it, and its gate."""
