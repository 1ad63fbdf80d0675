"""The wheel holds what git holds, in either way of building it."""

import ast
import re
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
import wheel_check

ROOT = wheel_check.ROOT


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return wheel_check.build(tmp_path_factory.mktemp("wheel"), from_sdist=False)


@pytest.mark.slow
def test_wheel_holds_exactly_what_git_tracks(wheel: Path) -> None:
    assert wheel_check.packed(wheel) == wheel_check.expected()


@pytest.mark.slow
def test_wheel_built_by_way_of_an_sdist_is_the_same(tmp_path: Path) -> None:
    assert wheel_check.packed(wheel_check.build(tmp_path, from_sdist=True)) == wheel_check.expected()


@pytest.mark.slow
def test_wheel_is_pure_python_and_under_sixty_megabytes_but_for_other_networks(wheel: Path) -> None:
    assert wheel.name.endswith("-py3-none-any.whl")
    own, peers = wheel_check.sizes(wheel)
    assert own < wheel_check.MAX_WHEEL_BYTES
    assert 1_000_000 < peers < wheel_check.MAX_PEERS_BYTES
    assert own + peers == wheel.stat().st_size


def test_no_file_of_the_shipped_folders_is_ignored_by_git() -> None:
    command = ["git", "ls-files", "--cached", "--ignored", "--exclude-standard", *wheel_check.MOVED]
    assert subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout == ""


def test_every_import_is_a_declared_dependency() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = [line for name, extra in project["optional-dependencies"].items() if name != "dev" for line in extra]
    lines = [*project["dependencies"], *extras]
    declared = {_normal(re.split(r"[\s\[<>=!~;]", line, maxsplit=1)[0]) for line in lines}
    homes = packages_distributions()
    for path in sorted((ROOT / "gfp_grasp").rglob("*.py")):
        for name in _imported(path) - set(sys.stdlib_module_names) - {"gfp_grasp"}:
            owners = {_normal(owner) for owner in homes.get(name, [name])}
            assert owners & declared, f"{path.relative_to(ROOT)} imports {name}, of {owners}: not in pyproject.toml"


def test_version_is_said_once_more_only_in_the_changelog() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    assert f'__version__ = "{version}"' in (ROOT / "gfp_grasp" / "__init__.py").read_text(encoding="utf-8")
    assert f"## [{version}]" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def _imported(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names.add(node.module.split(".")[0])
    return names


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
