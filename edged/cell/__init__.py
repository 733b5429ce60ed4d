"""The running cell: the loop from trigger to result, and its components."""
