"""PlenoPIV: from raw plenoptic images to a velocity field."""
