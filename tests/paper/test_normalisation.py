"""The study of plane intensities, on a volume of a few vectors."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.full

sys.path.append(str(Path(__file__).parents[2] / "paper"))


def test_reduced_study_writes_all_and_its_numbers_hold(tmp_path, capsys):
    import normalisation

    normalisation.main(reduced=True, out=tmp_path)
    assert (tmp_path / "normalisation.png").stat().st_size > 10_000
    found = json.loads((tmp_path / "normalisation.json").read_text())
    light = np.array(found["planes"]["exact"]["light"])
    true = np.array(found["true_light"])
    assert 0.4 < light.sum() / true.sum() < 0.9  # half a count an electron, and stray light
    weighted = {name: np.array(result["weight"]) for name, result in found["weights"].items()}
    np.testing.assert_array_equal(weighted["none"], 1.0)
    energy = normalisation.smooth(np.array(found["planes"]["exact"]["energy"]))
    assert np.ptp(energy * weighted["equal energy"] ** 2) < np.ptp(energy)
    inside = np.abs(np.array(found["z_mm"])) < 0.1
    assert weighted["focus"][inside].max() < 0.1 < weighted["focus"][~inside].max()
    assert all(0.2 < result["q"] < 1 for result in found["weights"].values())
    assert "less weight near focus (default)" in capsys.readouterr().out
