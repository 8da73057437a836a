"""sim_gap."""
