"""Fits of a model to a measurement: compiled kernels of fixed shape, and plain NumPy around them."""
