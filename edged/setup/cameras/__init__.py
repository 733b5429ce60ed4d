"""Setup of a cell's cameras: assignment to sides, exposure, gain, light and focus."""
