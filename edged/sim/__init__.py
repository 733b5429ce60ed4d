"""The virtual cell: simulated cameras and scenes with exactly known truth."""
