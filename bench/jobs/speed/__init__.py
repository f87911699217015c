"""Time and memory of calibration and of the virtual robot, compared with their bounds."""
