"""Paths on the ground: from formulas, from files, by name."""
