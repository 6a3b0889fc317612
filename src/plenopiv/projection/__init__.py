"""Rays between voxels and pixels: the one place where weights are computed, forward and back.

footprint.py   scalar leaves: the area of a patch of light inside a microlens' cell
geometry.py    camera and grid as the few numbers that a kernel needs, with the derivation
kernels.py     CPU loops: forward, adjoint and MART's back projection of one view
projector.py   the interface that reconstruction uses
"""
