"""The simulated car and what can be wrong with the hardware around it."""
