"""Pictures for people: what was measured, what was not, and why."""
