"""What a person sets: the car file, the options of a run, the thresholds of the watchdogs."""
