"""The machine of a cell: findings of edged doctor, backup and restore, and support bundles."""
