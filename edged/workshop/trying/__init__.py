"""Jobs that are tried in a running cell."""
