"""From two volumes to displacements, in voxels: 3D multi-grid cross-correlation with window deformation.

settings.py     what the user may choose
windows.py      where the windows lie, and a batch of them in memory
transforms.py   windows to spectra and back, sixteen lines at a time; butterflies.py their kernels
spectra.py      kernels: windows weighted, transformed, whitened, multiplied, and transformed back
agreement.py    weights of the places where two deformed windows show the same particles
correlation.py  one batch of windows: FFT, and the overlap of their weights
overlap.py      what that overlap does to peaks after whitening and smoothing
peaks.py        the peak and its sub-voxel position
offset.py       after the first pass: discrete window offset; offset_kernels.py its kernels
predictor.py    displacement between the vectors; the filter between passes
splines.py      sixteen samples of a volume at once, by cubic B-splines
deformation.py  both volumes sampled half a displacement apart
validation.py   normalised median test, and the replacement of outliers
solid.py        windows in a solid body, which are not measured
sub_windows.py  sub-window averaging: vectors as means over smaller windows
depth_response.py  what part of a displacement in depth a pass finds
noise_amplification.py  noise of the vectors over that of one correlation, after iteration and averaging
uncertainty.py  standard deviation of every vector
window_pass.py  one pass over the windows, batch by batch
pairs.py        what the passes ask of volumes
multigrid.py    one pass of a pair, and the loop over passes
ensemble.py     the same with correlations summed over many pairs
field.py        the result
"""
