"""Planes, circles, spheres, rotations and rigid transforms: fits with covariance."""
