"""What a job is worth before it is used: on live pairs, by a part that lies still, in the whole volume."""
