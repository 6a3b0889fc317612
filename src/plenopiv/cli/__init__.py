"""The command line: ``plenopiv init | simulate | calibrate | run | info | demo``.

app.py        the commands, their options and help; imports nothing heavy
commands_of_results.py   more of them: on what runs have left
commands_of_tracks.py    more of them: particles
commands_of_setup.py     more of them: orientation
messages.py   errors and warnings in one line each, exit codes
terminal.py   output as text, JSON lines or colours
progress.py   bars on a terminal, plain lines elsewhere
one module for the body of each command
"""

from plenopiv.cli.commands_of_setup import app
from plenopiv.cli.messages import main

__all__ = ["app", "main"]
