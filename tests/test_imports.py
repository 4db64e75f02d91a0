"""Import layers, what a process loads when it imports each package, sizes of folders, and the map of CONTRIBUTING."""

import ast
import re
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parent.parent
SOURCES = {
    "cli": ["roomlight_cli"],
    "client": ["roomlight_client"],
    "core": ["roomlight"],
    "export": ["roomlight_export"],
    "lab": ["roomlight_bench", "roomlight_evaluation", "roomlight_generator"],
    "model": ["roomlight_model"],
    "server": ["roomlight_server"],
}
TRAINING_EXTRA = {"torch", "onnx", "onnxscript", "tensorboard", "jax"}


def modules_of(*folders: str) -> list[str]:
    names: list[str] = []
    for folder in folders:
        root = ROOT / Path(folder).parts[0]
        for path in sorted((ROOT / folder).rglob("*.py")):
            parts = path.relative_to(root).with_suffix("").parts
            if not set(parts) & {"node_modules", "scripts"}:
                names.append(".".join(part for part in parts if part != "__init__"))
    return names


def files_of(folder: str) -> list[Path]:
    return [path for path in sorted((ROOT / folder).rglob("*.py")) if "node_modules" not in path.parts]


def loaded_after(*imports: str) -> set[str]:
    """Modules of a fresh interpreter after these imports."""
    code = f"import sys, {', '.join(imports)}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_import_layers_of_pyproject_are_kept():
    # In a process of its own: import-linter configures logging, which disables the loggers of later tests.
    code = "import sys; from importlinter.cli import lint_imports; sys.exit(lint_imports(no_cache=True))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_functions_that_kernels_alone_call_are_not_called_from_python():
    """Numba makes no entry for Python with `no_cpython_wrapper`: a call would be a segmentation fault."""
    made = re.compile(r"@njit\(\*\*(?:JIT|_INLINED)\)\ndef (\w+)")
    kernels = [path for path in files_of("core") if "kernels" in path.parts]
    inlined = {path.stem: set(made.findall(path.read_text())) for path in kernels}
    assert sum(map(len, inlined.values())) > 70
    assert "shading_normal" in inlined["surfaces"]
    for path in [path for folder in (*SOURCES, "tests") for path in files_of(folder) if "kernels" not in path.parts]:
        text = path.read_text()
        called = set(re.findall(r"(?<![\w.])(\w+)\(", text))
        through_module = set(re.findall(r"(?<![\w.])(\w+\.\w+)\(", text))
        wrong = through_module & {f"{module}.{name}" for module, names in inlined.items() for name in names}
        for module, imported in re.findall(r"from [\w.]+\.kernels\.(\w+) import (\([^)]*\)|.*)", text):
            wrong |= set(re.findall(r"\w+", imported)) & called & inlined.get(module, set())
        assert not wrong, f"{path.relative_to(ROOT)} calls {sorted(wrong)}"


def test_base_install_needs_no_training_extra():
    loaded = loaded_after(*modules_of("core", "server", "client", "lab/roomlight_evaluation"))
    assert {"roomlight", "numpy"} <= loaded
    assert not loaded & TRAINING_EXTRA


@pytest.mark.slow
def test_what_is_imported_at_once_is_of_the_base_install():
    """An import of another distribution belongs into the function that needs its extra."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    base = {canonicalize_name(Requirement(text).name) for text in project["dependencies"]}
    base |= {"llvmlite", "pydantic-core"}  # Numba and Pydantic require theirs
    ours = {name for names in SOURCES.values() for name in names}
    distributions = packages_distributions()
    others = dict[str, str]()
    for path in [*files_of("core"), *files_of("server"), *files_of("client/roomlight_client")]:
        for statement in ast.parse(path.read_text()).body:
            names = [alias.name for alias in statement.names] if isinstance(statement, ast.Import) else []
            names += [statement.module] if isinstance(statement, ast.ImportFrom) and statement.module else []
            for name in {name.partition(".")[0] for name in names} - ours - sys.stdlib_module_names:
                if not base & {canonicalize_name(of) for of in distributions.get(name, [name])}:
                    others[path.relative_to(ROOT).as_posix()] = name
    assert others == {}


@pytest.mark.parametrize(
    ("imported", "loaded", "later"),
    [
        ("roomlight", "roomlight", "onnxruntime av cv2 numba numpy OpenEXR embreex torch pydantic"),
        ("roomlight_client", "httpx", "torch onnxruntime roomlight_server roomlight_model embreex numba fastapi av"),
        pytest.param(
            *("roomlight_server.serving", "roomlight.engine.session"),
            "av roomlight.captures roomlight.compositing.compositor roomlight.compositing.loading",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_an_import_loads_nothing_that_only_some_calls_need(imported: str, loaded: str, later: str):
    modules = loaded_after(imported)
    assert loaded in modules
    assert not modules & set(later.split())


def test_each_source_folder_holds_its_packages_with_their_types():
    for folder, packages in SOURCES.items():
        importable = {
            path.stem
            for path in (ROOT / folder).iterdir()
            if path.suffix == ".py" or (path.is_dir() and (path / "__init__.py").is_file())
        }
        assert importable == set(packages)
        assert all((ROOT / folder / package / "py.typed").is_file() for package in packages)


MAX_FILES_PER_FOLDER = 15


def source_folders() -> dict[str, list[Path]]:
    """Folders with their Python files, by their path from the top folder of their package."""
    folders: dict[str, list[Path]] = {}
    for package in (ROOT / folder / package for folder, packages in SOURCES.items() for package in packages):
        for path in package.rglob("*.py"):
            folders.setdefault(path.parent.relative_to(package.parent).as_posix(), []).append(path)
    return folders


def test_no_source_folder_holds_too_many_files():
    counts = {name: sum(file.name != "__init__.py" for file in files) for name, files in source_folders().items()}
    assert {name: count for name, count in counts.items() if count > MAX_FILES_PER_FOLDER} == {}


def mapped_folders(page: str) -> set[str]:
    """Folders in the first column of CONTRIBUTING's tables, each from its package on; a heading or cell names that."""
    folders: set[str] = set()
    package = ""
    for line in page.splitlines():
        if line.startswith(("**`", "| `")):
            for name in re.findall(r"`([\w/]+)`", line.split(" | ")[0]):
                if path := re.search(r"roomlight\w*(/\w+)*", name):
                    package = path[0].partition("/")[0]
                folders.add(path[0] if path else f"{package}/{name.strip('/')}")
    return folders


def test_the_map_of_contributing_names_every_package_and_folder():
    folders = {name for name in source_folders() if not name.endswith("/kernels")}
    assert folders - mapped_folders((ROOT / "CONTRIBUTING.md").read_text()) == set()
