"""Statistics of many velocity fields, one after the other, and derivatives of one field, all with error bars.

series.py       SeriesStatistics: mean, RMS, Reynolds stresses, skewness and their uncertainty
phase.py        the same by the phase of a signal
moments.py      central moments, one sample after the other
correlated.py   how many samples are independent, from the correlation in time
convergence.py  running mean and RMS at a few places
variables.py    names, units and attributes
summary.py      a few numbers for summary.json
gradients.py    velocity gradients, vorticity, Q and divergence with error bars
"""

from plenopiv.statistics.gradients import velocity_gradients
from plenopiv.statistics.phase import Phases, PhaseStatistics
from plenopiv.statistics.series import SeriesStatistics
from plenopiv.statistics.summary import summary_of

__all__ = ["PhaseStatistics", "Phases", "SeriesStatistics", "summary_of", "velocity_gradients"]
