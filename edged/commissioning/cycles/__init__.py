"""Recorded cycles: looked at again, measured by what may come, and compared."""
