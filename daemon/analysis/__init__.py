"""Identification, diagnosis and simulation for notebooks (`import steerd`) and the command line."""
