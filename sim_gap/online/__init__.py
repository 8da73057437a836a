"""Learning while driving: a car's parameters and its gap, window by window, with bounded memory."""
