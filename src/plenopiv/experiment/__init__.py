"""The experiment file: one typed TOML file that says what was recorded, with which camera, and what to make of it.

tables.py     the tables and keys, each with its unit and limits
file.py       Experiment: load, camera, grid, recording, warnings, the resolved file
messages.py   what is wrong with a file, in one line
"""

from plenopiv.experiment.file import Experiment

__all__ = ["Experiment"]
