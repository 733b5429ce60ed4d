"""Matching points along rectified rows: NCC, then least squares (paper, eq. 8)."""
