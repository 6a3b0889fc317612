"""From two volumes to displacements, in voxels: 3D multi-grid cross-correlation with window deformation.

settings.py     what the user may choose
windows.py      where the windows lie
agreement.py    where two deformed windows show the same particles
correlation.py  one batch of windows: FFT, and its normalisation by overlap
peaks.py        the peak and its sub-voxel position
predictor.py    displacement between the vectors; the filter between passes
deformation.py  both volumes sampled half a displacement apart
validation.py   outliers and their replacement
uncertainty.py  standard deviation of every vector
multigrid.py    one pass, and the loop over passes
field.py        the result
"""
