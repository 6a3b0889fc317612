"""Which device computes: this processor by Numba, or a graphics processor by JAX; and how JAX is started.

"jax-cpu" is for tests: the code of a graphics processor on this processor, whole.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Literal

from plenopiv.errors import PlenoPIVError, brief
from plenopiv.kernels.store import folder

if TYPE_CHECKING:
    import jax

Kind = Literal["cpu", "gpu", "jax-cpu"]
Asked = Literal["cpu", "gpu", "auto", "jax-cpu"]

INSTALL = 'pip install "plenopiv[gpu]"'
OTHERWISE = 'or use compute.device = "cpu"'
PACKAGES = ("jax", "jaxlib", "jax-cuda12-plugin", "jax-cuda13-plugin", "jax-rocm7-plugin")  # versions may change bits
DETERMINISTIC = "--xla_gpu_deterministic_ops=true"  # no sums in the order in which threads happen to arrive
SHARE = ".9"  # of the device's memory, taken as it is needed: several workers may share a device
COMPILED_S = 0.2  # programs that took longer to compile are kept


@dataclass(frozen=True)
class Device:
    """``kind``; the device's own ``name``; bytes of its ``memory`` that may be taken, None where it does not say;
    ``versions`` of what computes there."""

    kind: Kind = "cpu"
    name: str = ""
    memory: float | None = None
    versions: tuple[tuple[str, str], ...] = ()

    @property
    def stated(self) -> str:
        """As the manifest has it: results of other devices may have other bits."""
        return self.kind if self.kind == "cpu" else f"{self.kind}: {self.name}"

    @property
    def text(self) -> str:
        """For the user."""
        if self.kind == "cpu":
            return "this processor"
        lends = "" if self.memory is None else f", {self.memory / 1e9:.2f} GB"
        return f"{self.name}{lends}, JAX {dict(self.versions)['jax']}"

    def shared_by(self, processes: int | None) -> Device:
        """The part of one of several processes on this machine."""
        if not processes or self.memory is None:
            return self
        return replace(self, memory=self.memory / processes)

    @contextmanager
    def in_use(self) -> Iterator[None]:
        """JAX computes on it."""
        _start(self.kind)  # in a worker, where no one has yet
        import jax

        with jax.default_device(_found("cpu" if self.kind == "jax-cpu" else "gpu")):
            yield


CPU = Device()


def device_of(asked: Asked, memory_gb: float | None = None) -> Device:
    """The device that is ``asked`` for; "auto": a graphics processor where there is one. ``memory_gb``: of it that may
    be taken, by default what it says that it has. Nothing is imported for "cpu".

    Raises:
        PlenoPIVError: it is not there, or JAX is not installed.
    """
    if asked == "cpu":
        return CPU
    if find_spec("jax") is None:
        if asked == "auto":
            return CPU
        raise PlenoPIVError(f'compute.device = "{asked}" needs JAX: {INSTALL}, {OTHERWISE}')
    try:
        _start(asked)
        found = _found("cpu" if asked == "jax-cpu" else "gpu")
    except (RuntimeError, ImportError) as error:
        if asked == "auto":
            return CPU
        raise PlenoPIVError(
            f'compute.device = "{asked}": JAX finds no such device here ({brief(error)}); {INSTALL} and a driver '
            f"that goes with it, {OTHERWISE}"
        ) from None
    kind: Kind = "jax-cpu" if asked == "jax-cpu" else "gpu"
    name = "this processor" if kind == "jax-cpu" else str(found.device_kind)
    return Device(kind, name, _memory(found, memory_gb), _versions())


def _start(asked: Asked) -> None:
    """Import JAX, told before what it reads when it starts; a program that started it earlier tells it itself."""
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    os.environ.setdefault("XLA_PYTHON_CLIENT_MEM_FRACTION", SHARE)
    flags = os.environ.get("XLA_FLAGS", "")
    if "xla_gpu_deterministic_ops" not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {DETERMINISTIC}".strip()
    if asked == "jax-cpu":
        os.environ.setdefault("JAX_PLATFORMS", "cpu")
    import jax

    if getattr(jax.config, "jax_compilation_cache_dir", None) is None:
        jax.config.update("jax_compilation_cache_dir", str(folder() / "jax"))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", COMPILED_S)


def _found(platform: str) -> jax.Device:
    import jax

    return jax.devices(platform)[0]


def _memory(device: Any, memory_gb: float | None) -> float | None:
    has = (device.memory_stats() or {}).get("bytes_limit")
    if has is None or memory_gb is None:
        return has if memory_gb is None else 1e9 * memory_gb
    if 1e9 * memory_gb > has:
        raise PlenoPIVError(
            f"compute.device_memory_gb = {memory_gb:g}: {device.device_kind} lends {has / 1e9:.2f} GB; ask for no more"
        )
    return 1e9 * memory_gb


def _versions() -> tuple[tuple[str, str], ...]:
    out = []
    for name in PACKAGES:
        try:
            out.append((name, version(name)))
        except PackageNotFoundError:
            continue
    return tuple(out)
