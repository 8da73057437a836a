"""The single-track car: one set of equations, generic over the number type.

Floats drive the simulated car, tensors the identification, SymPy symbols give exact Jacobians and
the source of compiled kernels.
"""
