"""Attacks on every reader and command: damaged files and odd options, drawn from a seed, each of which is one case."""
