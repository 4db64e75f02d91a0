"""`import roomlight as rl`: its public names, and the example of the package's docstring."""

import ast
import importlib
import re
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

import roomlight as rl
from roomlight import errors
from roomlight.images import decode_colour

PUBLIC = set(rl.__all__) - {"__version__"}


def test_type_checkers_see_every_public_name():
    """The imports under TYPE_CHECKING are the lazy names, and each comes from the module that the import names."""
    block = next(node for node in ast.parse(Path(rl.__file__).read_text()).body if isinstance(node, ast.If))
    imported = {name.name: node.module for node in ast.walk(block) if isinstance(node, ast.ImportFrom)
                for name in node.names}  # fmt: skip
    assert imported.keys() == PUBLIC
    for name, module in imported.items():
        assert module is not None
        assert getattr(importlib.import_module(module), name) is getattr(rl, name)


def test_every_error_is_public():
    classes = {name for name, value in vars(errors).items() if isinstance(value, type)}
    assert classes <= PUBLIC


def test_kernels_need_no_folder_that_can_be_written():
    """A container's user without a home got a traceback of numba."""
    code = """
from numba.core.caching import CompileResultCacheImpl
CompileResultCacheImpl._locator_classes = []
from roomlight.kernels import encode
"""
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stderr.count("set NUMBA_CACHE_DIR to a folder that can be written") == 1


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'Lamp'"):
        rl.Lamp  # noqa: B018  (the access is what is tested)
    assert not hasattr(rl, "Lamp")


@pytest.mark.parametrize(("name", "value"), [("model", "large"), ("provider", "gpu"), ("unknown_depth", "near")])
def test_an_unknown_name_in_an_option_is_an_option_error(name, value):
    options = rl.SessionOptions()
    object.__setattr__(options, name, value)  # past the test run's type checks
    with pytest.raises(rl.OptionError, match=f"^{name} is '{value}'; it must be one of "):
        options.__post_init__()


def test_the_version_is_stated_once():
    assert re.fullmatch(r"\d+\.\d+\.\d+", rl.__version__)
    root = Path(rl.__file__).parents[2]
    assert f'"{rl.__version__}"' not in (root / "pyproject.toml").read_text()


def test_the_example_runs(tmp_path, monkeypatch):
    assert rl.__doc__ is not None
    block = rl.__doc__[rl.__doc__.index("    import") : rl.__doc__.index("Conventions (")]
    (tmp_path / "my-capture").symlink_to(rl.sample_capture())
    monkeypatch.chdir(tmp_path)
    example = textwrap.dedent(block).replace("rl.open_capture(", "first_frames(")

    def first_frames(path):
        return rl.open_capture(path, rl.CaptureOptions(max_frames=2))

    names = {"first_frames": first_frames}
    exec(compile(example, "example", "exec"), names)
    light = names["light"]
    assert isinstance(light, rl.Light)
    assert light.frame == 1
    saved, _ = decode_colour((tmp_path / "light.exr").read_bytes(), "light.exr")
    np.testing.assert_allclose(saved, light.panorama, rtol=2**-10, atol=1e-6)
