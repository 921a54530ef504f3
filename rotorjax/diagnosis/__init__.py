"""Unbalance and bow from vibration: the linear inverse, and the network of Huang et al. with its compensation."""
