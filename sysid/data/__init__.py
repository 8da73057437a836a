"""Drives as arrays: segments, checks, windows, jitter of the log."""
