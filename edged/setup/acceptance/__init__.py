"""Checks on site that a cell measures as accurately as stated: acceptance tests, and studies of a size."""
