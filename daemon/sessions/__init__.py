"""Recorded drives for people: what is in one, how the car moved, its page."""
