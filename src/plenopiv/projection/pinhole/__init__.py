"""Pinhole cameras around a volume (Tomo-PIV), each of which is a view: ``projector`` and its ``kernels``."""
