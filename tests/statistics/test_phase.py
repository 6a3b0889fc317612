"""Phase averages, and the file of phases."""

import numpy as np
import pytest

from plenopiv.errors import PlenoPIVError
from plenopiv.statistics import Phases, PhaseStatistics, SeriesStatistics, summary_of


def phases(tmp_path, text, **options):
    path = tmp_path / "signal.csv"
    path.write_text(text)
    return Phases.read(path, **options)


def test_each_pair_is_in_the_bin_of_its_phase(tmp_path, field_of):
    """u follows the cosine of the phase, so that a bin off by one, or half of one, shows."""
    rng = np.random.default_rng(0)
    signal = 45.0 * np.arange(24) + rng.uniform(-10, 10, 24)
    lines = [f"{k},{phase}" for k, phase in enumerate(signal) if k != 5]
    found = phases(tmp_path, "pair,phase\n" + "\n".join(lines))
    fields = [
        field_of(np.cos(np.radians(phase)) * np.array([1.0, 0, 0])[:, None, None, None] * np.ones((3, 2, 2, 2)))
        for phase in signal
    ]
    statistics = PhaseStatistics(fields[0], found, 8)
    for k, field in enumerate(fields):
        statistics.add(field, k)
    result = statistics.result()
    assert result.pairs.values.tolist() == [3, 3, 3, 3, 3, 2, 3, 3]
    assert result.phase.values.tolist() == [0, 45, 90, 135, 180, 225, 270, 315]
    assert result.phase.attrs["units"] == "degree"
    np.testing.assert_allclose(result.u_mean.mean(["x", "y", "z"]), np.cos(np.radians(result.phase)), atol=0.18)
    assert result.u_mean.dims == ("phase", "z", "y", "x")
    assert summary_of(result)["pairs"] == 23
    alone = SeriesStatistics(fields[0], lags=4)
    for field in fields[2::8]:
        alone.add(field)
    for name in ("u_mean", "uu", "u_rms_std", "uv_std", "samples"):
        np.testing.assert_array_equal(result[name].sel(phase=90), alone.result()[name])


def test_bins_are_centred_and_a_period_closes(tmp_path):
    found = phases(tmp_path, "pair, Phase\r\n0,359.9\n1,0.1\n\n2,44.9\n3,45.1\n4,-10\n5,405\n")
    assert found.bins_of(4) == {0: 0, 1: 0, 2: 0, 3: 1, 4: 0, 5: 1}
    assert phases(tmp_path, "pair,phase\n3,1.5\n", period=2.0).bins_of(4) == {3: 3}


def test_an_empty_bin_holds_nothing(tmp_path, field_of):
    field = field_of(np.ones((3, 2, 2, 2)))
    statistics = PhaseStatistics(field, phases(tmp_path, "pair,phase\n0,0\n1,0\n"), 2)
    for pair in range(3):
        statistics.add(field, pair)
    result = statistics.result()
    assert result.pairs.values.tolist() == [2, 0]
    assert np.isnan(result.u_mean.sel(phase=180)).all()
    assert (result.u_mean.sel(phase=0) == 1).all()
    assert np.isnan(result.uu_std).all()  # of two pairs


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "line 1: wanted the header pair,phase"),
        ("0,1\n", "line 1: wanted the header pair,phase"),
        ("pair,phase\n", "names no pair"),
        ("pair,phase\n0,1\n1,x\n", "line 3: '1,x' is no pair and phase"),
        ("pair,phase\n1.5,2\n", "line 2"),
        ("pair,phase\n-1,2\n", "line 2"),
        ("pair,phase\n0,nan\n", "line 2"),
        ("pair,phase\n0,1,2\n", "line 2"),
        ("pair,phase\n0\n", "line 2"),
        ("pair,phase\n0,1\n0,2\n", "line 3: pair 0 has a phase already"),
        ('pair,phase\n0,"1\n', "is no CSV text"),
    ],
)
def test_what_is_wrong_is_one_line(tmp_path, text, said):
    with pytest.raises(PlenoPIVError, match=said) as raised:
        phases(tmp_path, text)
    assert str(raised.value).startswith(f"{tmp_path / 'signal.csv'}: ")
    assert "\n" not in str(raised.value)


def test_files_periods_and_pairs_that_cannot_be(tmp_path):
    with pytest.raises(PlenoPIVError, match=r"none\.csv: cannot be read"):
        Phases.read(tmp_path / "none.csv")
    (tmp_path / "signal.csv").write_bytes(b"pair,phase\n0,\xff\n")
    with pytest.raises(PlenoPIVError, match="is no CSV text"):
        Phases.read(tmp_path / "signal.csv")
    with pytest.raises(PlenoPIVError, match=r"pair 3: a phase of 1e\+308 is too large"):
        phases(tmp_path, "pair,phase\n0,1\n3,1e308\n", period=1e-5).bins_of(2)
    with pytest.raises(PlenoPIVError, match="a period of 0"):
        phases(tmp_path, "pair,phase\n0,1\n", period=0.0)
    found = phases(tmp_path, "pair,phase\n0,1\n7,1\n")
    found.check(8)
    with pytest.raises(PlenoPIVError, match=r"names pair 7, the series has pairs 0 to 6"):
        found.check(7)
    with pytest.raises(PlenoPIVError, match="0 bins"):
        found.bins_of(0)
