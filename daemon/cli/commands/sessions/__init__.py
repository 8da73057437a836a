"""Commands that read or write recorded drives."""
