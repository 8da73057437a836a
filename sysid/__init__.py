"""Identification by differentiable physics: car_model's equations over tensors and in kernels."""
