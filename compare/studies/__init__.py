"""Studies: many runs and a report of them."""
