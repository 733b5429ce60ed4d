"""Users: passwords, roles, invitations, sessions, and the audit of what they did."""
