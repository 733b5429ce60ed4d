"""Stereo calibration and its quality: adjustment, cross-validation, next best view, verification."""
