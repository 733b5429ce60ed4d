"""Scenes as values, and their pictures."""
