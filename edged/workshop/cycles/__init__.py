"""Recorded cycles of a running cell, and what is tried on them before it is used."""
