"""Prediction errors of windows under any hypothesis, and the noise that whitens them."""
