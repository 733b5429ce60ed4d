"""SETUP: one person at a time holds the cell and its cameras."""
