"""HTML reports: calibration and teaching."""
