"""Reference marks on the page: looked at, and taught."""
