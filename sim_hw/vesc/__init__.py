"""The simulated VESC: bytes of the serial link in and out."""
