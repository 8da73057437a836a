"""Commands by subject: each a function, whose docstring is the help, and its `NAME_arguments`."""
