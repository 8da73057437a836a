"""One module per subcommand: its docstring is the help; `add_arguments(parser)`, `run(args) -> int`."""
