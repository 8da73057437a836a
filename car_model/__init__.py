"""The single-track car: one set of equations, generic over the number type.

Floats drive the simulated car, tensors the identification; recorded numbers give exact Jacobians
and the source of compiled kernels.
"""
