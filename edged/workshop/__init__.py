"""Beside the loop: one process for long work, and what people draw up with it."""
