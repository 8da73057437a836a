"""Learning while driving: messages in, what was learnt out, beside the file of the car."""
