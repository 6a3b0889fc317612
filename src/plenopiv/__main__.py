"""``python -m plenopiv``: the command line, where the environment's scripts are not on the path."""

from plenopiv.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
