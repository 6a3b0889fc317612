"""Cameras: optics, lattice and pose of what records the light."""
