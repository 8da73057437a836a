"""The command line: one module per command, and what only commands need."""
