"""Calibration boards: what they are, and their marks in an image."""
