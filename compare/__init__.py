"""Command line, pictures and comparisons; reads results, steps nothing itself."""
