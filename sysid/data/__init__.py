"""Drives as arrays: commands and measurements, data checks, segments, windows, log jitter."""
