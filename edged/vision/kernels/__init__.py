"""Compiled arithmetic without a model: how kernels are compiled, Cholesky, median, robust weights, pixels."""
