"""Settings of a reconstruction that Python gives are refused where the experiment file refuses them."""

from dataclasses import replace

import numpy as np
import pytest

from plenopiv.errors import PlenoPIVError
from plenopiv.reconstruction.settings import TOMOGRAPHY, ReconstructionSettings

REFUSED = [
    ("method", "drtmart", '\'drtmart\' is not known; use "drt-mart" or "mart" or "mlos-mart"'),
    ("weights", "exakt", '\'exakt\' is not known; use "1-ray" or "9-rays" or "exact"'),
    ("candidates", "prodct", '\'prodct\' is not known; use "bound" or "product"'),
    *(("iterations", n, f"{n}; use a whole number from 1") for n in (0, -1, 1.5)),
    *(("relaxation", mu, f"{mu}; use a number above 0, at most 1") for mu in (0.0, -0.5, np.nan, 1.1)),
    *((name, n, f"{n}; use 0 or a positive number") for name in ("threshold", "focus_reach") for n in (-5.0, np.nan)),
    ("focus_reach", None, "None; use 0 or a positive number"),
    *(("seed", n, f"{n}; use a whole number from 0 to 9223372036854775807") for n in (-1, 1.5, 2**63)),
    ("motion_tracking", 4, "4; use a whole number from 0 to 3"),
]


@pytest.mark.parametrize(("name", "value", "message"), REFUSED)
def test_values_out_of_range(name, value, message):
    with pytest.raises(PlenoPIVError) as said:
        ReconstructionSettings(**{name: value})
    assert str(said.value) == f"reconstruction.{name}: {message}"


def test_values_at_the_ends_of_their_ranges():
    most = {"iterations": np.int64(1), "relaxation": 1, "threshold": 0.0, "focus_reach": 0, "seed": 2**63 - 1}
    assert ReconstructionSettings(**most, motion_tracking=3).seed == 2**63 - 1
    assert replace(TOMOGRAPHY, threshold=np.float32(3.0)).method == "mlos-mart"
