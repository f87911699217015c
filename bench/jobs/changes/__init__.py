"""Pairs of sessions of one robot with something changed between them, and studies of what pcalib says about them."""
