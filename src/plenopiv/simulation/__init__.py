"""Synthetic recordings: particles in a flow, traced through the camera, digitised like a sensor does.

- ``particles``: seeding a box at a number of particles per microlens
- ``flows``: velocity fields by name, analytic ones, and the advection of particles
- ``flow_file``: a velocity field from a file as a flow, and the jet that is shipped
- ``netcdf_grid``, ``vtk_image``: readers of such files; ``file_grid``: what they return, and its units
- ``gridded``: splines between the points of a grid
- ``images``: Monte-Carlo ray tracing of particles (Eqs. 1-5 of Shi, Ding & New 2016)
- ``pinhole_images``, ``board``: particles and a calibration board through pinhole cameras
- ``white``: the image of the evenly lit main lens under every microlens
- ``real_camera``, ``real_images``: a camera with window, stop, rim and distortion; its particles, white image and
  ``targets``; ``real_kernels`` and ``real_light`` trace the rays
- ``patches``: light of many particles gathered into one image
- ``sensor_noise``: electrons to counts
- ``simulated_recording``: a folder as a camera's user has it, with the truth beside it

Nothing here is shared with the projector that reconstruction uses, except the camera's parameters: the two check each
other.
"""
