"""How well the lattice is found in white images of random cameras: benchmarks/calibration/white_scores.json.

    python benchmarks/calibration/white_scores.py [--cameras 200] [--first 0]

Goes on where it was stopped: cameras that the file holds already are left out; --anew forgets them.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from pathlib import Path

import numpy as np
from random_cameras import cat_eye_px, draw, errors_px, random_camera

from plenopiv.calibration import find_lattice
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning

RESULTS = Path(__file__).with_name("white_scores.json")
RIGHT_PX = 0.3


def scored(seed):
    """One camera: what was found, as plain data."""
    of = random_camera(seed)
    camera, white = draw(of)
    out = {"cat_eye_px": round(cat_eye_px(of), 2), "spot": of.fill < 0.5}
    start = time.perf_counter()
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", PlenoPIVWarning)
        try:
            fit = find_lattice(white, camera, "white.tif")
        except PlenoPIVError as error:
            return out | {"refused": str(error), "seconds": round(time.perf_counter() - start, 1)}
        except (IndexError, ValueError, np.linalg.LinAlgError) as error:  # what no user should see
            return out | {"crashed": repr(error), "seconds": round(time.perf_counter() - start, 1)}
    error = errors_px(of, fit.lattice)
    return out | {
        "worst_px": round(float(error.max()), 4),
        "median_px": round(float(np.median(error)), 4),
        "warned": [str(w.message) for w in told if issubclass(w.category, PlenoPIVWarning)],
        "residual_px": round(fit.residual_px, 4),
        "region_px": round(fit.worst_region_px, 4),
        "array": fit.map_words if hasattr(fit, "map_words") else "",
        "seconds": round(time.perf_counter() - start, 1),
    }


def summary(found):
    """Counts over all cameras."""
    answered = [f for f in found if "worst_px" in f]
    right = [f for f in answered if f["worst_px"] <= RIGHT_PX]
    silent = [f for f in answered if f["worst_px"] > RIGHT_PX and not f["warned"]]
    return {
        "cameras": len(found),
        "answered": len(answered),
        "right": len(right),
        "wrong and warned": len(answered) - len(right) - len(silent),
        "wrong in silence": len(silent),
        "refused": sum("refused" in f for f in found),
        "crashed": sum("crashed" in f for f in found),
        "median_px": float(np.median([f["worst_px"] for f in answered])) if answered else None,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cameras", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--anew", action="store_true")
    parser.add_argument("--results", type=Path, default=RESULTS)
    options = parser.parse_args()
    found = {} if options.anew or not options.results.exists() else json.loads(options.results.read_text())
    for seed in range(options.first, options.first + options.cameras):
        if str(seed) in found:
            continue
        found[str(seed)] = scored(seed)
        found = dict(sorted(found.items(), key=lambda item: int(item[0])))
        options.results.write_text("{\n" + ",\n".join(f'"{k}": {json.dumps(v)}' for k, v in found.items()) + "\n}\n")
        f = found[str(seed)]
        words = f.get("refused") or f.get("crashed") or f"{f['worst_px']:.3f} px {f['array']} {'; '.join(f['warned'])}"
        print(f"{seed:4d} {f['seconds']:5.1f} s  cat {f['cat_eye_px']:5.2f}  {words}", flush=True)
    print(json.dumps(summary(list(found.values()))))


if __name__ == "__main__":
    main()
