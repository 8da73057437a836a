"""Commands that drive a car or talk to one that drives."""
