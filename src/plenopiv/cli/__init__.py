"""The command line: ``plenopiv init | simulate | calibrate | run | info | demo``.

app.py        the commands, their options and help; imports nothing heavy
series.py     those about a series of pairs
messages.py   errors and warnings in one line each, exit codes
terminal.py   output as text, JSON lines or colours
progress.py   bars on a terminal, plain lines elsewhere
one module for the body of each command
"""

from plenopiv.cli import series as _series  # registers its commands
from plenopiv.cli.app import app
from plenopiv.cli.messages import main

del _series

__all__ = ["app", "main"]
