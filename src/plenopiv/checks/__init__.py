"""Checks of a recording before anything is reconstructed: findings in plain words, with advice.

findings.py      Finding: severity, words, number, advice
white.py         the white image: lattice, f-numbers, light
fit.py           whether the frames' light falls where the white image has its microlenses; flips and turns
outlines.py      the same by where micro-images end, which settles what uneven light leaves in doubt
light.py         exposure and background of frames
                 seeding: particles per microlens, per pixel, per window
motion.py        displacement between two frames, from refocused pictures
at_rest.py       light that frames of different pairs have in common
filtered.py      frames that were smoothed or compressed with losses
stamps.py        times and cameras in the files
repeats.py       frames that are one image
reversal.py      pairs that are read as a sequence
pair.py          each pair of a run as it comes
explained.py     light of a frame that its volume does not explain
common.py        pairs whose frames have nothing in common
first_pair.py    light, seeding and displacement of one pair
result.py        what all of them found
whole_recording.py   all of them on one recording
"""

from plenopiv.checks.findings import Finding
from plenopiv.checks.pair import PairCheck, every_pair
from plenopiv.checks.result import CheckResult
from plenopiv.checks.whole_recording import check

__all__ = ["CheckResult", "Finding", "PairCheck", "check", "every_pair"]
