"""Completers as a user would write them, named `own_completers:...` in tests."""

import numpy as np
import trimesh

from gfp_grasp.errors import FitDiverged


def upright_box(detection):
    """The box around the points, standing on the support."""
    points = np.asarray(detection.cloud.points)
    low, high = points.min(axis=0), points.max(axis=0)
    low[2] = detection.support.height_m
    box = trimesh.creation.box(high - low)
    box.apply_translation((low + high) / 2)
    return box


def gives_up(detection):
    raise FitDiverged(f"nothing fits {len(detection.cloud.points)} points")


def returns_text(detection):
    return "a mesh"


NOT_A_FUNCTION = 3
