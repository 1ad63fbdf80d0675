"""Builds wheel and sdist, compares them with git, and runs the demo from the installed wheel in an empty folder.

`make wheel-check` runs it; tests/test_packaging.py uses its parts.
"""

import argparse
import os
import subprocess
import sys
import sysconfig
import tempfile
import venv
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
MAX_WHEEL_BYTES = 60_000_000  # but for the weights of other networks, which have a limit of their own
MAX_PEERS_BYTES = 24_000_000
_PEERS = "gfp_grasp/weights/peer_"
# Where the wheel puts the folders that stand beside the package in a checkout.
MOVED = {"sim_scenes": "gfp_grasp/sim_scenes", "gps": "gfp_grasp/gps", "gfp_grasp": "gfp_grasp"}


def build(folder: Path, *, from_sdist: bool) -> Path:
    """Build a wheel into the folder, either straight from the checkout or by way of an sdist."""
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder)]
    subprocess.run([*command, *([] if from_sdist else ["--wheel"]), str(ROOT)], check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    return wheel


def packed(wheel: Path) -> set[str]:
    """Names of the files in a wheel, its own metadata left out."""
    with zipfile.ZipFile(wheel) as archive:
        return {name for name in archive.namelist() if ".dist-info/" not in name}


def expected() -> set[str]:
    """Names that the wheel should hold: what git tracks, or would if it were added, of the shipped folders."""
    # Untracked files count, so that the comparison holds in a checkout where work is going on.
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", *MOVED]
    listed = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout.split("\n")
    names = {name for name in listed if name and (ROOT / name).is_file()}
    return {f"{MOVED[name.split('/', 1)[0]]}/{name.split('/', 1)[1]}" for name in names}


def install(wheel: Path, folder: Path) -> Path:
    """Install the wheel into a new environment and return its Python.

    The dependencies are those of the environment that runs this: a path file shows them to the new one. Path files
    in a folder that was added in this way are not read, so the editable install of the checkout stays out of sight.
    """
    venv.create(folder, with_pip=True)
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    command = [str(python), "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", str(wheel)]
    subprocess.run(command, check=True)
    purelib = subprocess.run(
        [str(python), "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"],
        check=True,
        capture_output=True,
        text=True,
    ).stdout.strip()
    (Path(purelib) / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n", encoding="utf-8")
    return python


def main() -> None:
    """Every check; stops at the first that fails."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--no-demo", action="store_true", help="leave out the run of the demo")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for from_sdist in (False, True):
            (folder / str(from_sdist)).mkdir()
            wheel = build(folder / str(from_sdist), from_sdist=from_sdist)
            missing, extra = expected() - packed(wheel), packed(wheel) - expected()
            if missing or extra:
                sys.exit(f"{wheel.name} (from sdist: {from_sdist}) lacks {sorted(missing)}, has extra {sorted(extra)}")
            own, peers = sizes(wheel)
            if own > MAX_WHEEL_BYTES or peers > MAX_PEERS_BYTES:
                limits = f"more than {MAX_WHEEL_BYTES} and {MAX_PEERS_BYTES}"
                sys.exit(f"{wheel.name} has {own} bytes and {peers} of other networks, {limits}")
            megabytes = f"{own / 1e6:.1f} MB and {peers / 1e6:.1f} MB of other networks"
            _say(f"{wheel.name}, from sdist: {from_sdist}: {len(packed(wheel))} files as in git, {megabytes}")
        python = install(wheel, folder / "venv")
        (folder / "empty").mkdir()
        where = "import gfp_grasp, sys; sys.exit('site-packages' not in gfp_grasp.__file__)"
        subprocess.run([str(python), "-c", where], cwd=folder / "empty", check=True)
        if not arguments.no_demo:
            subprocess.run([str(python), "-m", "gfp_grasp.demo", "--out", "out"], cwd=folder / "empty", check=True)
            _say(f"the demo wrote {len(list((folder / 'empty' / 'out').rglob('*')))} files from the installed wheel")


def sizes(wheel: Path) -> tuple[int, int]:
    """Bytes of a wheel without the weights of other networks, and of these."""
    with zipfile.ZipFile(wheel) as archive:
        peers = sum(info.compress_size for info in archive.infolist() if info.filename.startswith(_PEERS))
    return wheel.stat().st_size - peers, peers


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")


if __name__ == "__main__":
    main()
