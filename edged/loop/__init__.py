"""Parts of the loop: what it measures by, the commands that wait, one measurement, and what is told."""
