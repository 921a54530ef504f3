"""Measurements: vectors, tables, rig files, signals, simulated ones and those that the package ships."""
