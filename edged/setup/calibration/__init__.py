"""Calibration of a rig: boards, views, solution, check."""
