"""Is this recording good? What the images tell before anything is reconstructed, in plain words with advice.

findings.py      Finding: severity, words, number, advice
white.py         the white image: lattice, f-numbers, light
fit.py           whether the frames' light falls where the white image has its microlenses; flips and turns
light.py         exposure and background of frames
seeding.py       particles per microlens, per pixel, per window
motion.py        displacement between two frames, from refocused pictures
stamps.py        times and cameras that the files name
recording.py     all of them on one experiment
"""

from plenopiv.checks.findings import Finding
from plenopiv.checks.whole_recording import Checked, check

__all__ = ["Checked", "Finding", "check"]
