"""Differentiable Gaussian splatting."""
