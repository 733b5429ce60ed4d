"""SETUP: who has the cell, and its cameras meanwhile."""
