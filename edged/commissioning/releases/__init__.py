"""What a cell stands on, as archives to go back to."""
