"""Where the real scans and captures lie, for the tests that look at them."""

import os
from pathlib import Path

import pytest

VARIABLE = "GFP_GRASP_DATA"  # a folder; bench.detection reads it too
# Those who develop the package keep the data beside their checkout. This is the one place that may say so.
BESIDE_THE_CHECKOUT = Path(__file__).resolve().parents[2] / "shared" / "data"


def folder() -> Path:
    """Folder with meshes/ and captures/; skips the test where there is none."""
    path = Path(os.environ.get(VARIABLE) or BESIDE_THE_CHECKOUT)
    if not (path / "meshes").is_dir():
        pytest.skip(f"no real scans: set {VARIABLE} to a folder with meshes/ and captures/")
    return path
