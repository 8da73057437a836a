"""The filter's machine code, and the BLAS and LAPACK that it works with."""

import ctypes

from scipy.linalg import cython_blas, cython_lapack

_FUNCTIONS = (
    (cython_blas, "dgemm"),
    (cython_blas, "dgemv"),
    (cython_blas, "ddot"),
    (cython_lapack, "dposv"),
    (cython_lapack, "dpotrf"),
)


def attach(library: ctypes.PyDLL) -> None:
    """Give the machine code the BLAS and LAPACK that it works with."""
    functions = (ctypes.c_void_p * len(_FUNCTIONS))(*map(_address, *zip(*_FUNCTIONS, strict=True)))
    library.attach(functions)


def _address(module: object, name: str) -> int | None:
    """Address of a function that SciPy offers to compiled code."""
    capsule = module.__pyx_capi__[name]  # type: ignore[attr-defined]
    python = ctypes.pythonapi
    python.PyCapsule_GetName.restype = ctypes.c_char_p
    python.PyCapsule_GetName.argtypes = [ctypes.py_object]
    python.PyCapsule_GetPointer.restype = ctypes.c_void_p
    python.PyCapsule_GetPointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
    address: int | None = python.PyCapsule_GetPointer(capsule, python.PyCapsule_GetName(capsule))
    return address
