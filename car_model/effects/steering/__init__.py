"""Effects of the steering: command, servo, linkage."""
