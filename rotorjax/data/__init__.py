"""Measurements that the package ships."""
