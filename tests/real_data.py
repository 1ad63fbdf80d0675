"""Where the real scans and captures lie, for the tests that look at them."""

import os
from pathlib import Path

import pytest


def folder() -> Path:
    """Folder with meshes/ and captures/, from GFP_GRASP_DATA; skips the test where there is none."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    path = Path(os.environ.get("GFP_GRASP_DATA", default))
    if not (path / "meshes").is_dir():
        pytest.skip("no real scans: set GFP_GRASP_DATA to a folder with meshes/ and captures/")
    return path
