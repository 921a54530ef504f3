"""Measurements of a rotor with more detail than the model has, with effects hidden in it: NumPy and SciPy only."""
