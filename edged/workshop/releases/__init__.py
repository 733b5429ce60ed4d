"""What a running cell measures by: exchanged as releases."""
