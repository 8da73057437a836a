"""Effects of the tyres: stiffness, grip, build-up, slip."""
