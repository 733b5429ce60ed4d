"""Cameras while a cell is set up: which is left, exposure, gain, light and focus."""
