"""Rooms stand in rows: imports run downwards or along a row, and heavy libraries stay where they are."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

import gfp_grasp

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "gfp_grasp"
ROWS = (
    ("errors", "types", "assets", "transforms", "parallel", "journal", "plugins"),
    ("camera", "clouds", "meshes", "metrics", "shapes", "collision"),
    ("arguments", "observation", "primitives", "detect", "register", "deform", "grasps"),
    ("complete", "completers", "completion", "export", "scenes", "datasets", "captures"),
    ("envs", "train"),
    ("report", "attempts", "score", "scorepage", "bench", "cli", "demo", "view", "examples"),
)
ROW_OF = {room: row for row, rooms in enumerate(ROWS) for room in rooms}
# A prefix of the module's name under gfp_grasp, for each library that is slow to load or can crash.
HEAVY = {
    "torch": ("register.", "detect.", "deform.", "train.", "bench.ablation"),
    "coacd": ("collision.",),
    "vhacdx": ("collision.",),
    "mujoco": ("scenes", "camera.render", "envs.", "bench.hostile"),
    "ray": ("parallel.cluster",),
    "viser": ("view.",),
}
MODULES = sorted(PACKAGE.rglob("*.py"))


def test_every_room_stands_in_a_row() -> None:
    rooms = {path.relative_to(PACKAGE).parts[0].removesuffix(".py") for path in MODULES} - {"__init__"}
    assert rooms <= set(ROW_OF), f"rooms without a row: {sorted(rooms - set(ROW_OF))}"


def test_imports_never_run_upward() -> None:
    upward = [
        f"{room} (row {ROW_OF[room]}) imports {other} (row {ROW_OF[other]})"
        for room, others in _edges().items()
        for other in sorted(others)
        if ROW_OF[other] > ROW_OF[room]
    ]
    assert not upward, upward


def test_rooms_of_a_row_import_each_other_without_a_cycle() -> None:
    edges, done, path = _edges(), set(), []

    def visit(room: str) -> None:
        assert room not in path, " -> ".join([*path[path.index(room) :], room])
        if room not in done:
            path.append(room)
            for other in sorted(edges.get(room, ())):
                visit(other)
            done.add(path.pop())

    for room in sorted(edges):
        visit(room)


@pytest.mark.parametrize("library", sorted(HEAVY))
def test_heavy_library_is_imported_only_where_it_belongs(library: str) -> None:
    strays = [
        _name(path)
        for path in MODULES
        if library in {name.split(".")[0] for name in _imports(path)}
        and not _name(path).removeprefix("gfp_grasp.").startswith(HEAVY[library])
    ]
    assert not strays, f"{library} is imported in {strays}"


def test_importing_the_package_loads_no_heavy_library() -> None:
    code = f"import gfp_grasp, sys; print([n for n in {sorted(HEAVY)} if n in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_public_names_are_there() -> None:
    assert set(gfp_grasp.__all__) >= {"complete_to_mesh", "complete_scene", "decompose", "plan_grasps"}
    for name in gfp_grasp.__all__:
        assert callable(getattr(gfp_grasp, name))


def test_no_module_bears_the_name_of_a_function_that_its_package_exports() -> None:
    for path in MODULES:
        if path.name != "__init__.py":
            continue
        modules = {child.stem for child in path.parent.glob("*.py")} | {
            c.name for c in path.parent.iterdir() if c.is_dir()
        }
        assert not modules & _exported(path), (
            f"{_name(path)} exports {modules & _exported(path)}, which are also modules"
        )


def test_no_print_and_no_bare_except_in_the_library() -> None:
    for path in MODULES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id != "print", f"{_name(path)}:{node.lineno} prints"
            if isinstance(node, ast.ExceptHandler):
                caught = ast.unparse(node.type) if node.type else "everything"
                passed_on = isinstance(node.body[-1], ast.Raise) and node.body[-1].exc is None
                wide = caught in ("everything", "Exception", "BaseException")
                assert passed_on or not wide, f"{_name(path)}:{node.lineno} swallows {caught}"


def test_no_file_is_longer_than_350_lines() -> None:
    lines = {_name(path): len(path.read_text(encoding="utf-8").splitlines()) for path in MODULES}
    assert not {name: count for name, count in lines.items() if count > 350}


def test_tracked_files_name_no_place_of_one_machine() -> None:
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split(
        "\n"
    )
    place = re.compile(r"/(?:work|tmp|root)/|\.\.[/]shared|/home/\w|files\.pythonhosted|\bpypi\.org|registry\.npmjs")
    for name in filter(None, listed):
        path = ROOT / name
        if not path.is_file() or path.suffix in (".safetensors", ".gif", ".jpg", ".png", ".npz"):
            continue
        found = place.search(path.read_text(encoding="utf-8", errors="replace"))
        assert not found, f"{name} names {found.group() if found else ''}"


def _name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts) + ("." if path.name == "__init__.py" else "")


def _imports(path: Path) -> set[str]:
    """Absolute names of the modules that a file imports, wherever in the file it does so."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{path}:{node.lineno} imports relatively; say the whole name"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def _edges() -> dict[str, set[str]]:
    """Rooms that each room imports. Entry points (`__main__`) start a program and are not a part of their room."""
    edges: dict[str, set[str]] = {}
    for path in MODULES:
        room = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
        if room == "__init__" or path.name == "__main__.py":
            continue
        inner = {name.split(".")[1] for name in _imports(path) if name.startswith("gfp_grasp.")} - {"__version__"}
        edges.setdefault(room, set()).update(inner - {room})
    return edges


def _exported(init: Path) -> set[str]:
    """Public functions among the names that an `__init__` binds: those that are not classes or constants."""
    names = {name.rsplit(".", 1)[1] for name in _imports(init) if name.startswith("gfp_grasp.")}
    return {name for name in names if name.islower() and not name.startswith("_")}
