"""Simulated hardware against the clock: a pty and sockets."""
