"""A recording that the checks call unusable is refused; a pair that is, is set aside."""

import json
import os
import shutil
import time

import numpy as np
import pytest
import tifffile

import plenopiv
from plenopiv.cli import main
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.run.frame import reconstructed
from plenopiv.run.inputs import changed_frame, frame_entry, read_entry

pytestmark = pytest.mark.usefixtures("without_report")


@pytest.fixture
def folder(three_pairs, tmp_path):
    shutil.copytree(three_pairs, tmp_path / "run")
    return tmp_path / "run"


def turned(image):
    return image[:, ::-1]


def half_dark(image):
    out = image.copy()
    out[: image.shape[0] // 2] = 60 + np.random.default_rng(0).normal(0, 1.5, out[: image.shape[0] // 2].shape)
    return out


def cut_off(path):
    path.write_bytes(path.read_bytes()[:2000])


@pytest.mark.full
def test_a_damaged_frame_sets_its_pair_aside_and_the_exit_code_says_so(folder, capsys):
    cut_off(folder / "p2_a.tif")
    assert main(["run", str(folder / "experiment.toml")]) == 3
    out = capsys.readouterr().out
    assert "1 of 3 pairs set aside" in out
    summary = json.loads((folder / "results" / "summary.json").read_text())
    (aside,) = summary["set_aside"]
    assert aside["pair"] == 1
    assert aside["frames"] == ["p2_a.tif", "p2_b.tif"]
    assert "p2_a.tif" in aside["reason"]
    assert summary["quality"] == "doubtful"
    import xarray

    with xarray.open_dataset(folder / "results" / "velocity.nc") as velocity:
        assert velocity.time.values == pytest.approx([0.5 * 0.0005, 1.5 * 0.0005, 2.5 * 0.0005])
        assert np.isnan(velocity.u.values).all((1, 2, 3)).tolist() == [False, True, False]
        assert not velocity.valid.values[1].any()
        assert velocity.attrs["quality"] == "doubtful"


@pytest.mark.full
@pytest.mark.parametrize(("spoilt", "words"), [(turned, "mirrored"), (half_dark, "is dark where the other frame")])
def test_one_spoilt_frame_sets_its_pair_aside(folder, spoilt, words):
    image = tifffile.imread(folder / "p2_b.tif")
    tifffile.imwrite(folder / "p2_b.tif", np.ascontiguousarray(spoilt(image)).astype(np.uint16))
    with pytest.warns(plenopiv.PlenoPIVWarning, match=f"p2_b.tif is set aside.*{words}"):
        summary = plenopiv.process(plenopiv.load(folder / "experiment.toml")).summary
    assert [aside["pair"] for aside in summary["set_aside"]] == [1]


@pytest.mark.full
def test_a_spoilt_first_pair_does_not_condemn_the_others(folder):
    image = tifffile.imread(folder / "p1_a.tif")
    tifffile.imwrite(folder / "p1_a.tif", np.ascontiguousarray(turned(image)))
    with pytest.warns(plenopiv.PlenoPIVWarning, match="p1_a.tif and p1_b.tif is set aside"):
        summary = plenopiv.process(plenopiv.load(folder / "experiment.toml")).summary
    assert [aside["pair"] for aside in summary["set_aside"]] == [0]


@pytest.mark.full
def test_what_is_unusable_is_refused_and_can_be_forced(folder, capsys):
    for k in (1, 2, 3):
        shutil.copy(folder / f"p{k}_a.tif", folder / f"p{k}_b.tif")
    assert main(["run", str(folder / "experiment.toml")]) == 2
    error = capsys.readouterr().err.strip().split("\n")[-1]
    assert "p1_a.tif and p1_b.tif are one image" in error
    assert "--force" in error
    assert not (folder / "results").exists()
    result = plenopiv.process(plenopiv.load(folder / "experiment.toml"), force=True)
    assert result.velocity.attrs["quality"] == result.summary["quality"] == "forced"


def test_no_pair_left(folder):
    for k in (1, 2, 3):
        cut_off(folder / f"p{k}_b.tif")
    with pytest.raises(PlenoPIVError, match=r"p\d_b\.tif"):
        plenopiv.process(Experiment.load(folder / "experiment.toml"))
    assert not (folder / "results").exists()


@pytest.mark.parametrize("then", ["replaced", "gone"])
def test_the_manifest_has_a_frame_s_file_as_it_was_when_it_was_read(experiment, then):
    """A file that is replaced while its frame is reconstructed must be another one to the next run."""
    recording, path = experiment.recording(), experiment.folder / "a.tif"
    before, other = path.stat(), experiment.folder / "b.tif"

    class Meanwhile:
        projection = None
        reconstruction = ReconstructionSettings()

        def reconstruct(self, *given):
            shutil.copy(other, path) if then == "replaced" else path.unlink()

    entry = reconstructed(Meanwhile(), recording, 0, lambda *given: None).entry
    assert (entry["name"], entry["bytes"], entry["mtime_ns"]) == ("a.tif", before.st_size, before.st_mtime_ns)
    if then == "replaced":
        frames = [entry, read_entry(frame_entry(recording.frames[1]), recording.light(1)[0])]
        assert "a.tif is another image" in changed_frame(recording, {"pair": 0, "frames": frames})


def test_a_lost_frame_that_is_mended_keeps_the_size_and_the_time_of_its_file(folder):
    """As rsync -a leaves them, which a transfer that broke off had set too."""
    path, experiment = folder / "p2_b.tif", Experiment.load(folder / "experiment.toml")
    whole, before = path.read_bytes(), path.stat()

    def written(content):
        path.write_bytes(content)
        os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
        return experiment.recording()

    recording = written(bytes(len(whole)))
    record = {"pair": 1, "frames": [frame_entry(recording.frames[k]) for k in recording.pairs[1]]}
    assert changed_frame(recording, record) is None
    time.sleep(0.02)  # by which clocks of file systems tell changes apart
    assert "p2_b.tif is another image" in changed_frame(written(whole), record)


@pytest.mark.full
@pytest.mark.parametrize("content", [b"", b"no image at all", bytes(4096)], ids=["empty", "text", "zeros"])
def test_a_frame_s_file_that_is_no_image_sets_its_pair_aside(folder, content, capsys):
    (folder / "p2_b.tif").write_bytes(content)
    assert main(["run", str(folder / "experiment.toml")]) == 3
    (aside,) = json.loads((folder / "results" / "summary.json").read_text())["set_aside"]
    assert aside["pair"] == 1
    assert "p2_b.tif" in aside["reason"]
    assert ("empty" if not content else "no image file") in aside["reason"]
