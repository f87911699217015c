"""The benchmark of the diagnosis: effects hidden by MuJoCo, at sizes stated in units of noise."""
