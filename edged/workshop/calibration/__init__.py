"""Drafts of calibrations in a running cell, and checks of the rig in use."""
