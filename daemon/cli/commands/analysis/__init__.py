"""Commands that learn the car and find what its model lacks."""
