"""The chain on a graphics processor, by JAX; the same code runs, whole, on the processor.

    backend          which device computes; work, rates: what a stage takes of it
    projection       a projection on the device; form: what programs for it are compiled for
    plenoptic        plenoptic cameras; plane_tables, planes, view_places: what it works with
    several, pinhole several plenoptic cameras, pinhole cameras
    candidates       dense ray tracing; in_focus, weights: what it works with
    mart             MART
    reconstruct      from a frame to a volume
    volume           a dense volume, and the list of its voxels that comes back
    memory           what a frame takes of the device's memory
    correlation      displacement fields: the passes of multigrid; correlation_*: its parts

JAX is optional. Nothing outside this subpackage imports it, and ``backend`` only once a device was asked for.
"""
