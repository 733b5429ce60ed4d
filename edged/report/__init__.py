"""HTML reports: calibration, teaching, acceptance test and week."""
