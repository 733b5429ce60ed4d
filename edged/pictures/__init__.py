"""Pictures for people that show what was measured, what was not, and why."""
