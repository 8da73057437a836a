"""car_model."""
