"""The filter's numeric inside in machine code, bit for bit what the Python filter computes."""
