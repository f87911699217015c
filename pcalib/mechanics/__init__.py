"""Robots as rods between anchors: closure, kinematics, statics."""
