"""The loop without a clock: virtual time on simulated hardware, and replay of a recording."""
