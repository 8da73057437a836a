"""Lane keeping: path errors to steering and speed, designed and checked before the car moves.

`make_controller` (in `steerd.controller.build`, at start) turns a car, a path and a configuration
into plain numbers; `control` (in `steerd.controller.lane_controller`) is one pure tick.
"""
