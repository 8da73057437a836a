"""The simulated car's step in machine code, bit for bit what its equations give on floats."""
