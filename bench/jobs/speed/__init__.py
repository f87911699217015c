"""What calibration and the virtual robot cost, beside the bounds that they are held to."""
