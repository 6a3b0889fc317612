"""OpenPTV on the images of four cameras, run by pinhole_peer.py in an environment of its own:

    openptv_peer.py FOLDER

FOLDER holds scene.npz: ``images`` (cameras, rows, columns) uint8; of the cameras ``position`` (3,), ``turn`` (3, 3),
rows right, up and backward, ``focal_mm``, ``pixel_mm``; ``limits`` (3, 2) mm. For each threshold in grey levels targets
are found, matched within an epipolar band and placed; found.npz has the places of quadruplets alone, and of triplets
and pairs too, and seconds of processor time.
"""

import sys
import time
from pathlib import Path

import numpy as np
from optv.calibration import Calibration
from optv.correspondences import MatchedCoords, correspondences
from optv.orientation import point_positions
from optv.parameters import ControlParams, TargetParams, VolumeParams
from optv.segmentation import target_recognition

THRESHOLDS = 8, 15, 25, 40  # grey levels: the caller takes the best
BAND_MM = 0.01  # on the sensor, two pixels


def calibration(position, turn, focal_mm):
    """Rotation omega, phi, kappa: the transposed axes are Rx Ry Rz."""
    matrix = turn.T
    angles = np.arctan2(-matrix[1, 2], matrix[2, 2]), np.arcsin(matrix[0, 2]), np.arctan2(-matrix[0, 1], matrix[0, 0])
    return Calibration(position, np.array(angles), np.array([0.0, 0.0, focal_mm]), glass=np.array([0.0, 0.0, 1e-4]))


def main(folder):
    scene = np.load(folder / "scene.npz")
    images, pixel, limits = scene["images"], float(scene["pixel_mm"]), scene["limits"]
    cameras, rows, columns = images.shape
    control = ControlParams(
        cameras, ["headers"], (columns, rows), (pixel, pixel), cam_side_n=1.0, wall_ns=[1.0], wall_thicks=[1e-6],
        object_side_n=1.0,
    )  # fmt: skip
    volume = VolumeParams(
        x_span=limits[0], z_spans=[limits[2], limits[2]], pixels_tot=0.0, pixels_x=0.0, pixels_y=0.0, ref_gray=0.0,
        epipolar_band=BAND_MM, min_correlation=0.0,
    )  # fmt: skip
    each = [calibration(*of) for of in zip(scene["position"], scene["turn"], scene["focal_mm"], strict=True)]
    out = {}
    for threshold in THRESHOLDS:
        wanted = TargetParams(
            discont=100, gvthresh=[threshold] * 4, pixel_count_bounds=(2, 200), xsize_bounds=(1, 40),
            ysize_bounds=(1, 40), min_sum_grey=3 * threshold, cross_size=2,
        )  # fmt: skip
        begun = time.process_time()
        targets = [target_recognition(image, wanted, k, control) for k, image in enumerate(images)]
        flat = [MatchedCoords(own, control, camera) for own, camera in zip(targets, each, strict=True)]
        _, numbers, _ = correspondences(targets, flat, each, volume, control)
        places = []
        for clique in numbers:  # of four cameras, three and two
            if clique.shape[1] == 0:
                places.append(np.empty((0, 3)))
                continue
            seen = np.array([own.get_by_pnrs(which) for own, which in zip(flat, clique, strict=True)])
            places.append(point_positions(seen.transpose(1, 0, 2), control, each, volume)[0])
        out[f"quadruplets_{threshold}"], out[f"all_{threshold}"] = places[0], np.concatenate(places)
        out[f"seconds_{threshold}"] = time.process_time() - begun
    np.savez(folder / "found.npz", **out)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
