"""Every cycle of a cell as one row: spooled, packed into Parquet, asked in SQL (`edged[history]`)."""
