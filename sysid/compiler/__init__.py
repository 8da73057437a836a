"""The kernel compiler: from the vehicle equations of `car_model` to SIMD machine code.

What goes in: a tuple of effects (`car_model.effect.Effect`) and a chassis. What comes out: a module
of functions compiled by Numba, used through `kernels`:

    march               simulates W windows side by side: (steps + 1, STATES + memory, slots)
    march_back          its adjoint: derivatives of a loss by parameters, first states, commands
    settle              where commands before the windows bring the steering
    compute_readings    instrument readings (rows,) and their forward sensitivities (rows, n)
    delays_of           dead times of steer, drive and pose [s]

The stages, one file each (trace, specialised, layout and threads in `car_model.native`):

    trace                   runs `car_model` on symbols: five recorded pieces (actuators, rates,
                            remember, observe, delays)
    specialised             the rates again, shortened for speeds above walking pace
    layout                  names for the rows that a piece reads and writes
    codegen                 prints each piece as Python: `_jac`, `_jvp`, `_rows`, `_vjp`
    delayed, loops, forward_sensitivities, march_windows
                            hand-written loops around the pieces, appended as text
    arguments               the typed bundles that the entry points take
    compile                 Numba's options: what is inlined, what is an entry point
    simd_rows, simd_math, choice
                            vectors of SLOTS numbers, functions and selects without branches
    modules                 writes the text to the cache folder by its hash, and imports it
    threads                 shares blocks or windows among threads
    kernels                 NumPy arrays in, NumPy arrays out

`pieces.pyi` declares what `codegen` prints, for type checkers. How arrays lie in memory, how the
cache works, how to look at the generated source and where to look when something breaks:
docs/explanation/kernel-compiler.md.
"""
