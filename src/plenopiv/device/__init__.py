"""The chain on a graphics processor, by JAX; the same code runs, whole, on the processor.

    backend                    which device computes; what is asked for and is not there
    correlation                displacement fields: the passes of ``displacement.multigrid``
    correlation_deformation    planes of a volume on the device, deformed
    correlation_windows        windows -> correlations -> peaks, and their scatter
    correlation_agreement      weights where both windows agree
    correlation_offset         discrete window offset
    correlation_memory         what is held on the device

JAX is optional. Nothing outside this subpackage imports it, and ``backend`` only once a device was asked for.
"""
