"""Meshes as a scene takes them: an open one is closed, a closed one is the very same."""

import numpy as np
import pytest
import trimesh

from gfp_grasp.scenes.objects import solid_mesh


def test_an_open_mesh_is_closed_and_a_solid_is_taken_as_it_is() -> None:
    box = trimesh.creation.box((0.1, 0.06, 0.04))
    assert solid_mesh(box) is box
    open_box = box.copy()
    open_box.update_faces(np.arange(len(box.faces)) != 0)  # without one triangle
    assert not open_box.is_volume
    closed = solid_mesh(open_box)
    assert closed.is_volume
    assert closed.volume == pytest.approx(box.volume, rel=0.01)
