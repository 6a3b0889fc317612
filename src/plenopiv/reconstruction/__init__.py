"""From a light field, or the images of several cameras, to a volume: candidate voxels (DRT, MLOS) and MART."""
