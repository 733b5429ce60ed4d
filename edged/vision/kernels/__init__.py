"""Compilation of kernels, and general ones: Cholesky, median, robust weights, pixel formats."""
