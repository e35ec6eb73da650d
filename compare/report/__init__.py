"""A report as a self-contained page, JSON and table."""
