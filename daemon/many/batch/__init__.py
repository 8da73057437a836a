"""Hundreds of sessions at once: each a row; what changed on which car, and since when."""
