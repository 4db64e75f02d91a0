"""The documentation names what is there: API pages all public names, the map of the code its files."""

import re
from pathlib import Path

import pytest

import roomlight as rl

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
SOURCES = [ROOT / name for name in ("core", "server", "client", "model", "export", "lab", "cli")]
PUBLIC_PACKAGES = ("light", "captures", "dataset", "wire", "engine", "compositing")
DIRECTIVE = re.compile(r"^::: ([\w.]+)\n((?: {4,}.*\n)*)", re.MULTILINE)


def documented() -> dict[str, set[str] | None]:
    """Return the modules of the API pages with their members, or None for all members."""
    modules: dict[str, set[str] | None] = {}
    for page in sorted((DOCS / "api").glob("*.md")):
        for module, options in DIRECTIVE.findall(page.read_text() + "\n"):
            members = re.search(r"members: \[(.*)\]", options)
            modules[module] = set(re.findall(r"\w+", members[1])) if members else None
    return modules


@pytest.mark.parametrize("name", sorted(set(rl.__all__) - {"__version__"}))
def test_every_public_name_is_on_an_api_page(name: str):
    modules = documented()
    value = getattr(rl, name)
    module = "roomlight.conventions" if name == "Position" else value.__module__
    assert module in modules
    members = modules[module]
    assert members is None or name in members


@pytest.mark.parametrize("package", [f"roomlight.{name}" for name in PUBLIC_PACKAGES] + ["roomlight_client"])
def test_every_public_package_has_an_api_page(package: str):
    assert package in documented()


def test_every_page_is_in_the_navigation():
    named = set(re.findall(r": ([\w/-]+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.MULTILINE))
    assert named == {str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md")}


def test_files_of_the_architecture_exist():
    named = set(re.findall(r"[\w./-]*\w+\.py\b", (DOCS / "architecture.md").read_text()))
    files = [path.as_posix() for source in SOURCES for path in source.rglob("*.py")]
    assert len(named) > 30
    assert {name for name in named if not any(file.endswith("/" + name) for file in files)} == set()


def test_pages_have_at_most_130000_characters():
    assert sum(len(page.read_text()) for page in DOCS.rglob("*.md")) <= 130_000
