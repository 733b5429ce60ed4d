"""Calibration boards: their specifications, and the detection of their marks in an image."""
