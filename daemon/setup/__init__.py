"""Before the first drive: probing the hardware, checking mocap, calibrating the car."""
