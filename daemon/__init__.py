"""The daemon and its command line: processes, runners, states, and what people type."""
