"""Two velocity fields side by side: how far they differ, in m/s and in standard deviations. No truth is needed.

overlap.py      where both have vectors; one read at the other's, linearly
differences.py  mean, RMS, median, largest of differences, one time after the other
result.py       what a comparison finds: Comparison
"""

from plenopiv.comparison.differences import Differences, Measures
from plenopiv.comparison.overlap import Field, Overlap
from plenopiv.comparison.result import Comparison, Row, Setting, Shown

__all__ = ["Comparison", "Differences", "Field", "Measures", "Overlap", "Row", "Setting", "Shown"]
