"""Cycle history: one row per cycle, spooled, packed into Parquet, queried in SQL (`edged[history]`)."""
