"""Each numbered example runs as a new user would run it: by its name, in an empty folder, at a small size."""

import subprocess
import sys
from pathlib import Path

import pytest

import gfp_grasp.examples

FOLDER = Path(gfp_grasp.examples.__file__).parent
# Arguments that keep an example small, words that it says, and files that it writes.
RUNS = {
    "01_complete_a_cloud": ((), "watertight: True", ("completed.glb",)),
    "02_whole_picture": ((), "object 0: mug", ("object_0.ply",)),
    "03_export_and_simulate": ((), "convex parts", ("object.xml",)),
    "04_plan_and_try_a_grasp": (("0",), "reward", ()),
    "05_score_your_completer": (("1",), "beside oracle", ("score.json",)),
    "06_add_a_class": (("6",), "urn", ("my_gps/urn.json", "urn.glb")),
    "07_train": (("2",), "", ("pcrnet.safetensors",)),
    "08_a_street": ((), "vehicles stand still in street.xml", ("street.xml", "street.glb")),
}


def test_every_numbered_example_is_run_here() -> None:
    assert {path.stem for path in FOLDER.glob("[0-9]*.py")} == set(RUNS)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(RUNS))
def test_the_example_runs_in_an_empty_folder(name: str, tmp_path: Path) -> None:
    arguments, words, files = RUNS[name]
    command = [sys.executable, "-m", f"gfp_grasp.examples.{name}", *arguments]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert words in done.stdout
    for file in files:
        assert (tmp_path / file).is_file()
