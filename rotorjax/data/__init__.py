"""Measurements: vectors, tables, rig files, recordings, signals, simulated ones and those that the package ships."""
