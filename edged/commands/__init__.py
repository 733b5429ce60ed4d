"""Implementation of each command; `cli` only parses, and these functions return exit codes."""
