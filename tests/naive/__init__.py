"""The plain-loop twin of each fast kernel, a module for each room."""
