"""Cars that nobody here wrote, driven and judged by the commands of the README.

Three plants behind one interface, `drive(plant, commands, seed)`: the blind test's own four wheels
with all of their structure, a car in MuJoCo, and CommonRoad's multi-body car. See the README beside
this file.
"""
