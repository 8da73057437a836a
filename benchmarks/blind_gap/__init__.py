"""A blind test of the sim-to-real diagnosis: hidden effects, sealed answers, scores.

The plant shares no code with `car_model`: four wheels, brush tyres, its own integrator. See the
README beside this file for the protocol.
"""
