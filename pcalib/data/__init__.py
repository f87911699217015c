"""Measurements and targets: files, their columns, and what may be wrong with them."""
