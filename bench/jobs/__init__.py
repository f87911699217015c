"""Jobs that put both sides together: what the virtual robot does and what pcalib makes of it."""
