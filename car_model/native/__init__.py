"""The one compiled library: the equations of `car_model` as C, printed and built with the package.

trace, specialised  record the equations, shorten them for speeds above walking pace
print_c, layout     print the record as C for eight windows side by side
vectors.h, march.h  elementary functions; the loops around the printed pieces
build               prints and compiles `equations.so` (the package's build hook calls it)
library             loads it
windows             NumPy arrays in, NumPy arrays out
"""
