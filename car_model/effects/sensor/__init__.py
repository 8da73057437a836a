"""Effects of the measurement: mocap's body, yaw and clock."""
