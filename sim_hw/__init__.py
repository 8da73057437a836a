"""Simulated hardware: a car, a VESC and a mocap server that know only the real wires.

Nothing here knows a clock but `links`; everything else is given ``t_ns`` and seeded noise.
"""
