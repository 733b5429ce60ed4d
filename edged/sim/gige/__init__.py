"""A GigE Vision camera in pure Python, over real UDP."""
