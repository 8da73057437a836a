"""Putting a run together: settings, path, design, loop and links become one value."""
