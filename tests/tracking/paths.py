"""Particles on known paths as frames see them: positions with errors of known covariance."""

import numpy as np

from plenopiv.tracking.frame import FrameParticles
from plenopiv.tracking.sightings import SeenFrame

STD_MM = np.array([0.001, 0.001, 0.004])
FAR = ((-1e3, 1e3),) * 3


def as_seen(position_mm, std_mm=STD_MM, light=None, rng=None):
    """Particles at (n, 3), put off by errors of ``std_mm`` if there is an ``rng``."""
    n = len(position_mm)
    covariance = np.zeros((n, 4, 4))
    covariance[:, range(3), range(3)] = np.broadcast_to(std_mm, (n, 3)) ** 2
    covariance[:, 3, 3] = 1.0
    off = 0.0 if rng is None else rng.normal(size=(n, 3)) * std_mm
    light = np.full(n, 100.0) if light is None else light
    information = np.linalg.inv(covariance[:, :3, :3])
    return FrameParticles(position_mm + off, light, covariance, np.ones(n), 1.0, information, np.zeros((n, 3)))


def seen_frames(path, frames, n, rng=None, std_mm=STD_MM, present=None):
    """The frames of particles 0 to n at ``path(t)`` (n, 3) at times t in frames; ``present(t)``: which are seen."""
    out = []
    for t in range(frames):
        here = np.arange(n) if present is None else np.flatnonzero(present(t))
        out.append(SeenFrame(t, as_seen(path(float(t))[here], std_mm, rng=rng), here))
    return out


def parabolas(n, seed=1):
    """Places (n, 3) mm, velocities (n, 3) mm a frame and accelerations (n, 3) mm a frame^2, another size and sign on
    each axis, and the path that they make."""
    rng = np.random.default_rng(seed)
    start = rng.uniform(-1, 1, (n, 3))
    velocity = np.array([0.05, -0.03, 0.08]) + 0.01 * rng.normal(size=(n, 3))
    bend = np.array([-0.004, 0.002, 0.006]) + 0.001 * rng.normal(size=(n, 3))
    return start, velocity, bend, lambda t: start + velocity * t + 0.5 * bend * t**2
