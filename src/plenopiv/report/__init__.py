"""The report of a run: one HTML file that stands alone.

views.py      what the figures show: crops of raw images with the lattice, projections of a volume
figures.py    the figures (matplotlib, no global state)
page.py       the page around them: numbers, warnings, settings
"""

from plenopiv.report.page import write_report
from plenopiv.report.views import Projections, RawCrop, projections, raw_crops

__all__ = ["Projections", "RawCrop", "projections", "raw_crops", "write_report"]
