"""``plenopiv correlate --ensemble``: one field of the kept volumes of many pairs, or one for each phase."""

import json

import numpy as np
import pytest

import plenopiv
from plenopiv.cli import main
from plenopiv.experiment import Experiment
from plenopiv.io import read_velocity
from plenopiv.io.series_file import open_series
from plenopiv.io.volumes import read_volume
from plenopiv.run.calibrated import calibrated_chain

pytestmark = pytest.mark.usefixtures("without_report")


@pytest.mark.full
def test_an_ensemble_is_one_field_of_all_pairs(masked, tmp_path, capsys):
    assert main(["correlate", str(masked), "--ensemble", "--out", str(tmp_path / "one"), "--fine-passes", "1"]) == 0
    assert "2 pairs in 1 ensemble (0 left out)\n" in capsys.readouterr().out
    made = read_velocity(tmp_path / "one" / "velocity.nc")
    experiment = Experiment.load(tmp_path / "one" / "experiment.toml")
    chain, recording, _ = calibrated_chain(experiment, experiment.recording())
    volumes = [read_volume(masked / f"volume-{name}.h5") for name in "abc"]
    wanted = chain.ensemble([(volumes[0], volumes[1]), (volumes[1], volumes[2])], recording.dt_s)
    for name, values in wanted.data_vars.items():
        assert made[name].values.tobytes() == values.values.tobytes(), name
    assert made.time.values == pytest.approx([2 * 0.5 * recording.dt_s])
    assert made.pairs.values.tolist() == [2]
    summary = json.loads((tmp_path / "one" / "summary.json").read_text())
    assert summary["ensemble"] == {"pairs": [2], "pairs_left_out": 0}
    assert set(summary["reconstruction"]) == {"a.tif", "b.tif", "c.tif"}


@pytest.mark.full
def test_a_field_for_each_phase(masked, tmp_path, capsys):
    """The first pair moves there, the second one back; of one pair an ensemble is that pair's field."""
    phases = tmp_path / "encoder.csv"
    phases.write_text("pair,phase\n0,185\n1,5\n")
    options = ["--phase", str(phases), "--bins", "2", "--fine-passes", "1"]
    assert main(["correlate", str(masked), "--ensemble", "--out", str(tmp_path / "two"), *options]) == 0
    assert "2 pairs in 2 ensembles (phase 0: 1, 180: 1; 0 left out)\n" in capsys.readouterr().out
    alone = plenopiv.correlate(masked, out=tmp_path / "alone", fine_passes=1).velocity
    found = open_series(tmp_path / "two" / "velocity.nc")
    for name in "uvw":
        np.testing.assert_array_equal(found[name].values, alone[name].values[::-1])
    assert found.phase.values.tolist() == [0, 180]
    assert found.phase.units == "degree"
    assert found.pairs.values.tolist() == [1, 1]
    assert found.time.values == pytest.approx([0.00075, 0.00025])
    assert found.swap_dims(time="phase").u.sel(phase=180).dims == ("z", "y", "x")
    assert main(["correlate", str(masked), "--ensemble", "--out", str(tmp_path / "two"), *options]) == 0
    assert "nothing to do" in capsys.readouterr().err
    phases.write_text("pair,phase\n0,5\n1,185\n")
    assert main(["correlate", str(masked), "--ensemble", "--out", str(tmp_path / "two"), *options]) == 2
    assert "holds a run of other inputs (ensemble.pairs" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("lines", "options", "words"),
    [
        (
            "0,5\n1,185\n",
            ["--ensemble", "--bins", "3"],
            "has a phase of 120 +- 60; use fewer bins than 3, of which 2 are filled",
        ),
        ("0,5\n2,185\n", ["--ensemble"], "names pair 2, the series has pairs 0 to 1"),
        ("0,5\n1,185\n", [], "--phase: averages correlations; give --ensemble too"),
    ],
)
def test_phases_that_do_not_fit_are_one_line(masked, tmp_path, lines, options, words, capsys):
    (tmp_path / "phases.csv").write_text(f"pair,phase\n{lines}")
    assert main(["correlate", str(masked), "--phase", str(tmp_path / "phases.csv"), *options]) == 2
    assert words in capsys.readouterr().err
    assert not list(masked.parent.glob("results-*"))
