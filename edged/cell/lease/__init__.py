"""SETUP: one person at a time has the cell and its cameras."""
