"""Effects of the body: masses, inertia, loads."""
