"""Effects of the drive: speed command, motor, battery, drag."""
