"""steer_bus."""
