"""Which program and which libraries computed a result."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version

LIBRARIES = ("numpy", "scipy", "numba", "llvmlite", "xarray", "h5py", "tifffile", "matplotlib")


def versions() -> dict[str, str]:
    """Versions of PlenoPIV, Python, the libraries that compute, and the operating system."""
    import plenopiv

    found = {"plenopiv": plenopiv.__version__, "python": platform.python_version()}
    for library in LIBRARIES:
        try:
            found[library] = version(library)
        except PackageNotFoundError:  # pragma: no cover - installed without metadata
            found[library] = "unknown"
    return {**found, "system": f"{platform.system()} {platform.machine()}"}
