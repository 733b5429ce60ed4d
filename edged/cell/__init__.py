"""The running cell: the loop from trigger to result, and what it is made of."""
