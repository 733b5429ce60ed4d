"""Recorded cycles: viewing, comparing, and measuring again."""
