"""steerd: control, identification and sim-to-real diagnosis for Ackermann cars."""
