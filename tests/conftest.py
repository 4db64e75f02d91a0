"""The test run checks array shapes: every annotated function of the project is wrapped by jaxtyping and beartype.

Installed before any import of the project. Packages called `kernels` are left out, because numba compiles their
functions from their own source and takes no wrapper.
"""

from pathlib import Path

from jaxtyping import install_import_hook

_ROOT = Path(__file__).parent.parent
_SOURCES = [_ROOT / folder for folder in ("core", "model", "export", "server", "client")]


def _modules() -> list[str]:
    names: list[str] = []
    for source in _SOURCES:
        for path in sorted(source.rglob("*.py")):
            parts = path.relative_to(source).with_suffix("").parts
            if path.name != "__init__.py" and "kernels" not in parts:
                names.append(".".join(parts))
    return names


install_import_hook(_modules(), "beartype.beartype")
