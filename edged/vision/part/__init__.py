"""A found part measured in space: pose, features, sizes, consistency, acceptance (paper, 5)."""
