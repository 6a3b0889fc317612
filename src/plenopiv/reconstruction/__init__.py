"""From a light field to a volume of intensities: candidate voxels (DRT) and MART."""
