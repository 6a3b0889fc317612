"""What a kernel's hash takes in: each edit that could change its machine code, and no other."""

import dis
import importlib
import re
import sys
from pathlib import Path
from types import CodeType

import numba
import numpy as np
import pytest

import plenopiv
from plenopiv.kernels import fingerprint, sources
from plenopiv.kernels.numba_internals import Kernel
from plenopiv.kernels.store import Store

ROOT = Path(__file__).parents[2]
MODULES = {
    "__init__": "",
    "top": '''
"""Top."""
from tiny import settings, shapes
from tiny.leaf import GAIN, TABLE, leaf
from tiny.shapes import Pair
from tiny.vectors import added

from plenopiv.kernels import kernel


@kernel
def top(x, more=2):
    """What it does."""
    pair = Pair(x, GAIN)
    return leaf(pair.b) + TABLE[1] * more + settings.DEEP.SCALE + added(x)


@kernel
def of_pair(pair):
    return pair.a


def other():
    return 1
''',
    "leaf": '''
import numpy as np
from tiny.twig import twig

from plenopiv.kernels import part

GAIN = np.float32(0.5)
TABLE = np.array([1.0, 2.0])
POWER = 3


@part
def leaf(x):
    """A leaf."""
    return twig(x) ** POWER


@part
def unused(x):
    return x
''',
    "twig": """
from plenopiv.kernels import inlined


def made(factor):
    @inlined
    def scaled(x):
        return x * factor if x > 0 else scaled_down(x)

    return scaled


@inlined
def scaled_down(x):
    return 0.5 * x


twig = made(1.25)
""",
    "settings": "from tiny import deep as DEEP\nUNUSED = 1\n",
    "deep": "SCALE = 4.0\nUNUSED = 2\n",
    "shapes": "from typing import NamedTuple\n\n\nclass Pair(NamedTuple):\n    a: float\n    b: float\n",
    "vectors": """
from tiny.words import WORD

from plenopiv.kernels import intrinsic


@intrinsic
def added(typing, x):
    return x(x), lambda context, builder, signature, arguments: builder.fadd(arguments[0], arguments[0])
""",
    "words": "WORD = 8\n",
    "odd": """
from tiny.mode import MODE

from plenopiv.kernels import kernel


@kernel
def odd(x):
    return x * MODE.factor
""",
    "mode": "class Mode:\n    factor = 2.0\n\n\nMODE = Mode()\n",
}
HASHED = ("top", "odd", "of_pair")


@pytest.fixture
def hashes(tmp_path, monkeypatch):
    """The hashes of the kernels of ``tiny`` after edits (module, from, to), in a folder of their own."""
    count = 0

    def forget():
        for name in [name for name in sys.modules if name.partition(".")[0] == "tiny"]:
            del sys.modules[name]
        sources.text_of.cache_clear()
        sources.hash_of_sources.cache_clear()

    def hashed(*edits):
        nonlocal count
        count += 1
        folder = tmp_path / str(count) / "tiny"
        folder.mkdir(parents=True)
        texts = dict(MODULES)
        for module, before, after in edits:
            assert before in texts[module]
            texts[module] = texts[module].replace(before, after, 1)
        for module, text in texts.items():
            (folder / f"{module}.py").write_text(text)
        forget()
        with monkeypatch.context() as patch:
            patch.syspath_prepend(str(folder.parent))
            top, odd, shapes = (importlib.import_module(f"tiny.{name}") for name in ("top", "odd", "shapes"))
            pair = numba.typeof(shapes.Pair(1.0, 2.0))
            signatures = (numba.float64,), (numba.float64,), (pair,)
            found = [Store(k.py_func, k.targetoptions).path(s, "machine") for k, s in
                     zip((top.top, odd.odd, top.of_pair), signatures, strict=True)]  # fmt: skip
        assert all(found)
        return dict(zip(HASHED, found, strict=True))

    yield hashed
    forget()


def changed(hashes, *edits):
    before, after = hashes(), hashes(*edits)
    return {name for name in HASHED if before[name] != after[name]}


@pytest.mark.parametrize(
    "edit",
    [
        ("top", '"""What it does."""', '"""What it does, said\n    in two lines."""'),
        ("top", '    """What it does."""\n', ""),
        ("top", "    pair =", "    # why\n\n    pair ="),
        ("top", "@kernel\ndef top", "# a comment above\n\n\n@kernel\ndef top"),
        ("top", "    return 1\n", "    return 2\n"),
        ("leaf", '"""A leaf."""', '"""A leaf, said otherwise."""'),
        ("leaf", "    return x\n", "    return 2 * x\n"),
        ("leaf", "GAIN =", "\n\nANOTHER = 1\nGAIN ="),
        ("settings", "UNUSED = 1", "UNUSED = 3"),
        ("deep", "UNUSED = 2", "UNUSED = 3"),
        ("top", "return 1", "return leaf"),
    ],
)
def test_what_changes_no_machine_code_changes_no_hash(hashes, edit):
    assert changed(hashes, edit) == set()


@pytest.mark.parametrize(
    ("edit", "kernels"),
    [
        (("top", "+ TABLE", "- TABLE"), {"top"}),
        (("top", "more=2", "more=3"), {"top"}),
        (("top", "TABLE[1]", "TABLE[0]"), {"top"}),
        (("top", "pair.b", "pair.a"), {"top"}),
        (("top", "@kernel\ndef top", "from plenopiv.kernels import plain_kernel\n@plain_kernel\ndef top"), {"top"}),
        (("leaf", "** POWER", "* POWER"), {"top"}),
        (("leaf", "POWER = 3", "POWER = 3.0"), {"top"}),
        (("leaf", "np.float32(0.5)", "np.float64(0.5)"), {"top"}),
        (("leaf", "[1.0, 2.0]", "[1.0, 2.5]"), {"top"}),
        (("leaf", "import part", "import plain_part as part"), {"top"}),
        (("twig", "made(1.25)", "made(1.5)"), {"top"}),
        (("twig", "return 0.5 * x", "return 0.25 * x"), {"top"}),
        (("deep", "SCALE = 4.0", "SCALE = 5.0"), {"top"}),
        (("shapes", "a: float\n    b: float", "b: float\n    a: float"), {"top", "of_pair"}),
        (("vectors", "builder.fadd", "builder.fmul"), {"top"}),
        (("words", "WORD = 8", "WORD = 16"), {"top"}),
        (("mode", "factor = 2.0", "factor = 3.0"), {"odd"}),
    ],
)
def test_what_may_change_machine_code_changes_the_hash(hashes, edit, kernels):
    assert kernels <= changed(hashes, edit)


def test_a_folder_has_no_part_in_it(hashes):
    assert hashes() == hashes()


def test_what_has_no_text_is_not_kept():
    space = {"__name__": "nowhere", "thing": object()}
    exec("def reads(x):\n    return x if thing else x\n", space)
    assert Store(space["reads"], {}).path((numba.float64,), "machine") is None


def test_signature_flags_and_machine_count():
    def function(x):
        return x

    settings = [((numba.float64,), {}, "one"), ((numba.float32,), {}, "one"), ((numba.float64,), {}, "two")]
    settings += [((numba.float64,), {"fastmath": True}, "one"), ((numba.typeof(0.5)[:],), {}, "one")]
    found = {fingerprint.fingerprint(function, flags, types, machine) for types, flags, machine in settings}
    assert len(found) == len(settings)


def test_running_a_function_leaves_its_hash():
    """Python rewrites byte code that runs often."""

    def function(x, n):
        for _ in range(n):
            x = x + np.pi
        return x

    before = fingerprint.fingerprint(function, {}, (), "")
    fingerprint._taken_apart.cache_clear()
    for _ in range(200):
        function(1.0, 200)
    assert fingerprint.fingerprint(function, {}, (), "") == before


# --- the kernels themselves


@pytest.fixture(scope="module")
def kernels():
    source = Path(plenopiv.__file__).parent
    for path in source.rglob("*.py"):
        if "from plenopiv.kernels import" in path.read_text():
            importlib.import_module(".".join(("plenopiv", *path.relative_to(source).with_suffix("").parts)))
    modules = [module for name, module in sys.modules.items() if name.startswith("plenopiv")]
    return {id(k): k for module in modules for k in vars(module).values() if isinstance(k, Kernel)}.values()


def inner(code):
    return [code, *(c for held in code.co_consts if isinstance(held, CodeType) for c in inner(held))]


def test_globals_are_those_that_the_disassembler_finds(kernels):
    assert len(kernels) > 60
    for k in kernels:
        found = [i.argval for code in inner(k.py_func.__code__) for i in dis.get_instructions(code)
                 if i.opname == "LOAD_GLOBAL"]  # fmt: skip
        assert set(fingerprint._taken_apart(k.py_func.__code__, k.py_func.__doc__)[1]) == set(found), k


def test_of_modules_only_those_of_intrinsics_count_as_a_whole(kernels, monkeypatch):
    """Everything else that kernels take is told apart."""
    asked = set()
    monkeypatch.setattr(fingerprint, "hash_of_sources", lambda module: asked.add(module) or "")
    for k in kernels:
        assert fingerprint.fingerprint(k.py_func, k.targetoptions, (), "")
    written = {m for m in asked if "@intrinsic" in Path(sys.modules[m].__file__).read_text()}
    assert asked == written
    assert len(asked) == 5


def test_private_parts_of_numba_are_in_one_file():
    private = re.compile(r"\bnumba\.(core|np|cpython|misc)\b|from numba import .*\bcore\b|\b__class__ = ")
    folders = [
        folder for folder in ROOT.iterdir() if folder.is_dir() and folder.name[0] != "." and folder.name != "build"
    ]
    files = {path for folder in folders for path in folder.rglob("*.py") if private.search(path.read_text())}
    assert files == {ROOT / "src/plenopiv/kernels/numba_internals.py"}
