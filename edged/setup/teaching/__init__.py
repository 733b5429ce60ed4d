"""Jobs taught from pictures and drawings."""
