"""Makes ``tests/oracles`` importable: slow, obvious references that several rooms are tested against."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
