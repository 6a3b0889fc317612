"""The page docs/fuzzing.md, from the results."""

from __future__ import annotations

from fuzz_cases import KINDS
from fuzz_results import Results

HEAD = """# Fuzzing: files that no person wrote

Written by `campaigns/fuzz.py table`. Each case is a small whole file that was spoilt, by chance or where its parser
looks, and a command that reads it, in a process of its own. A case has failed when its command shows a traceback, ends
otherwise than with exit code 0 or 2, takes more than 10 s or 2 GB, writes anything on stderr but the program's own
lines (with exit code 2 one line of error, which names a file or a key), or leaves anything behind that it was not asked
for.

| kind | spoilt | commands |
|---|---|---|
| image | TIFF in thirteen forms, PNG, NumPy, HDF5 | `info`, `init`, `calibrate`, `check`, `views` |
| experiment | experiment file | `info`, `calibrate`, `check` |
| optics | optics sheet in JSON and TOML | `init` |
| flow | netCDF4, VTK images in seven forms, and what the experiment file says of them | `simulate` |
| results | `velocity.nc` of one and of two times | `info`, `export` |

How files are spoilt: bits and bytes changed, cut, repeated, inserted (200 kB of blanks), spliced; numbers of a text
replaced by extremes (0, 1e30, NaN, 5,000 digits), lines and words exchanged, brackets nested thousands deep, other
encodings; keys of tables removed, renamed, of other types; entries of TIFF directories changed; addresses within HDF5
files led round in circles, data sets of other types and shapes, terabytes that are stated and gigabytes of zeros that
are packed, odd attributes.

## Results
"""
TAIL = """
`make test-full` tries 200 cases of another seed. `campaigns/fuzz.py --case image:17` repeats one case and shows what
its command says; `--keep FOLDER` keeps its files.

## What it found

Of the program as it was before, 259 of these 3,000 cases fail: 155 results, 69 flow files, 14 optics sheets, 11 images
and 10 experiment files. Most of them end in the HDF5 library, which corrupts the heap on damaged files or does not
return, and in h5netcdf, whose objects raise once more when they are closed. HDF5 files are therefore tried in a child
process first, with a limit of 5 s and 1 GB (`plenopiv.hdf5`). That takes 0.2 s; a file is tried once, until it changes.
Files of up to 256 MB of data are read whole by the child, of larger ones the headers alone: one of that size whose
header is whole and whose data are damaged can still end the program.
"""


def table(results: Results) -> str:
    """The page's text."""
    rows = ["| kind | cases | read | refused | failed | longest | most memory |", "|---|---|---|---|---|---|---|"]
    for kind in KINDS:
        held = results.of(kind)
        longest, most = held["slowest"].get("seconds", 0), held["largest"].get("gb", 0)
        rows.append(
            f"| {kind} | {held['cases']} | {held['read']} | {held['refused']} "
            f"| {results.count_failed(kind)} | {longest:.1f} s | {most:.2f} GB |"
        )
    every = [results.of(kind) for kind in KINDS]
    total = {name: sum(held[name] for held in every) for name in ("cases", "read", "refused", "seconds")}
    failed = sum(map(results.count_failed, KINDS))
    rows.append(f"| all | {total['cases']} | {total['read']} | {total['refused']} | {failed} | | |")
    about = results.machine
    where = f"{about.get('cores', '?')} cores ({about.get('processor', '?')}; Python {about.get('python', '?')})"
    return (
        HEAD + "\n" + "\n".join(rows) + "\n\n"
        f"Seed {results.seed}; {total['seconds'] / 60:.0f} minutes of commands, one at a time, on a machine of {where}."
        " Memory is that of the whole process, 0.2 GB of it the program and its libraries.\n" + TAIL
    )  # fmt: skip
