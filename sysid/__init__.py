"""sysid."""
