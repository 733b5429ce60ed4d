"""What each command does; `cli` only parses, these return exit codes."""
