"""The machine of a cell, and what is kept of the cell elsewhere: findings, backup, a file for who helps."""
