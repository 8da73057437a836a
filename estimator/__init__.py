"""The car's state from mocap poses, wheel speed and gyro, each fused at its time of validity.

An extended Kalman filter over the single-track model of `car_model`; see
`docs/explanation/filter.md`.
"""
