"""A module for each subcommand: its docstring is the help, with `add_arguments` and `run`."""
