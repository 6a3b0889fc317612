"""From two volumes to displacements, in voxels: 3D multi-grid cross-correlation with window deformation.

settings.py     what the user may choose
windows.py      where the windows lie
transforms.py   windows to spectra and back, sixteen lines at a time; butterflies.py their kernels
spectra.py      windows weighed, transformed, whitened, multiplied, and back
agreement.py    where two deformed windows show the same particles
correlation.py  one batch of windows: FFT, and its normalisation by overlap
peaks.py        the peak and its sub-voxel position
offset.py       the first pass' second look, windows offset by whole voxels
predictor.py    displacement between the vectors; the filter between passes
splines.py      sixteen samples of a volume at once, by cubic B-splines
deformation.py  both volumes sampled half a displacement apart
validation.py   outliers and their replacement
averaging.py    vectors as means of inner windows
growth.py       what iteration and that mean make of a window's noise
uncertainty.py  standard deviation of every vector
multigrid.py    one pass, and the loop over passes
field.py        the result
"""
