"""Recorded cycles: looked at, compared, measured again."""
