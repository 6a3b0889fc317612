"""The report of a run: one self-contained HTML file, and its figures as PNG and PDF.

views.py      what the figures show: crops of raw images with the lattice, projections of a volume
figures.py    images and histograms (matplotlib, no global state)
charts.py     line charts: residuals, validation, uncertainty, errors by depth
convergence.py  how the statistics of a series settle
stacks.py     pictures for sliders: planes of the volume, views of the light field, refocusing
moments.py    times, mean and RMS of a series, read one field after the other
field.py      these as the page's scripts read them
limits.py     limits of colours from the data
facts.py      the facts of the run at the top
viewers.py    what turns and slides, as HTML
document.py   the HTML around it: escaping, content-security policy
page.py       the page as a whole
browser/      style sheet and scripts (3D scene, slices, sliders)
"""

from plenopiv.report.moments import Series, series_of_file
from plenopiv.report.page import write_report
from plenopiv.report.stacks import Stack, light_field_stacks, volume_stack
from plenopiv.report.views import Projections, RawCrop, projections, raw_crops

__all__ = [
    "Projections",
    "RawCrop",
    "Series",
    "Stack",
    "light_field_stacks",
    "projections",
    "raw_crops",
    "series_of_file",
    "volume_stack",
    "write_report",
]
