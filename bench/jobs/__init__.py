"""Jobs that run the virtual robot and pcalib together: the robot measures, and pcalib calibrates from its data."""
