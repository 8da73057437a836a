"""The VESC motor controller on its serial link: framing, packets, units, port and client."""
