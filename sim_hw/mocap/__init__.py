"""The simulated mocap system: cameras, servers, network."""
