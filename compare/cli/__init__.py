"""The command line: commands, progress and tables at a terminal."""
