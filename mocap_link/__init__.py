"""mocap_link."""
