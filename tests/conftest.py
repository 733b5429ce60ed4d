"""This file makes the helpers beside it (naive, snapshots, ...) importable from every test below."""
