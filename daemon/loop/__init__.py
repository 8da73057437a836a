"""The control core: events in, orders and messages out. No process, no terminal, no file."""
