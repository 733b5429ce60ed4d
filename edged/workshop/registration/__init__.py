"""Drafts of registrations in a running cell."""
