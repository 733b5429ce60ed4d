"""Checking and teaching reference marks on the page."""
