"""The fit: objective, Levenberg-Marquardt, covariance, identifiability, validation."""
