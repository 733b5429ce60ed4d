"""Stereo calibration and what it is worth: adjustment, cross-validation, next view, verification."""
