"""Drafts of jobs in a running cell."""
