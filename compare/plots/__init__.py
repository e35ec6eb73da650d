"""Figures: style, pictures of one run, pictures of reports."""
