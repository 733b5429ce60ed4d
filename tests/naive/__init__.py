"""The plain-loop twin of each fast kernel, one module per package of edged."""
