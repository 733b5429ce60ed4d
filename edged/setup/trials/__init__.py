"""Jobs tried on live pictures."""
