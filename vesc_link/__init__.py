"""vesc_link."""
