"""Users: passwords, roles, invitations, sessions, and the audit log of their actions."""
