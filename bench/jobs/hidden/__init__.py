"""Robots with something hidden in them, of a known visible size: what blind tests and the benchmark are made of."""
