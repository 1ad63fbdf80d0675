"""The one file that knows where sim_scenes/, gps/ and weights/ are, in a wheel and in a checkout."""

from pathlib import Path

from gfp_grasp.errors import AssetMissing

_PACKAGE = Path(__file__).resolve().parent


def data_dir(name: str) -> Path:
    """Folder of shipped data: inside the package (wheel), or beside it where pyproject.toml stands (checkout).

    Args:
        name: "sim_scenes", "gps" or "weights".

    Raises:
        AssetMissing: Neither place has it; the installation is incomplete.
    """
    inside = _PACKAGE / name
    if inside.is_dir():
        return inside
    beside = _PACKAGE.parent / name
    if (_PACKAGE.parent / "pyproject.toml").is_file() and beside.is_dir():
        return beside
    raise AssetMissing(f"data folder {name!r} is neither in {_PACKAGE} nor beside it: reinstall gfp_grasp")


def data_file(name: str, file: str) -> Path:
    """Path of one shipped file.

    Raises:
        AssetMissing: The file is not there; the message lists what is.
    """
    folder = data_dir(name)
    path = folder / file
    if not path.is_file():
        there = ", ".join(sorted(p.name for p in folder.iterdir())) or "nothing"
        raise AssetMissing(f"{name}/{file} is missing; the folder holds: {there}. Reinstall gfp_grasp or rebuild it")
    return path
