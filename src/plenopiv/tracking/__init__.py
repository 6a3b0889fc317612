"""Particles from raw pixels: positions, light and error bars of each, links between frames."""
