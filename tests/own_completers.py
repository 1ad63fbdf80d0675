"""Completers, planners and a detector as a user would write them, named `own_completers:...` in tests."""

import numpy as np
import trimesh

from gfp_grasp.camera import cloud_of
from gfp_grasp.detect import DetectConfig, make_detection
from gfp_grasp.errors import FitDiverged
from gfp_grasp.grasps import plan_grasps
from gfp_grasp.types import SupportPlane


def upright_box(detection):
    """The box around the points, standing on the support."""
    points = np.asarray(detection.cloud.points)
    low, high = points.min(axis=0), points.max(axis=0)
    low[2] = detection.support.height_m
    box = trimesh.creation.box(high - low)
    box.apply_translation((low + high) / 2)
    return box


def open_box(detection):
    """The same box without its first two faces, which make one of its sides."""
    box = upright_box(detection)
    box.update_faces(np.arange(len(box.faces)) >= 2)
    return box


def gives_up(detection):
    raise FitDiverged(f"nothing fits {len(detection.cloud.points)} points")


def returns_text(detection):
    return "a mesh"


def plans_lazily(completion, num, *, seed):
    """A generator that never ends, of the best antipodal grasp."""
    best = plan_grasps(completion, 1, seed=seed)[0]
    while True:
        yield best


def plans_nothing(completion, num, *, seed):
    return ["a grasp"]


def plans_badly(completion, num, *, seed):
    raise ZeroDivisionError("of my own making")


def all_above_the_table(image, *, up):
    """Everything more than 4 mm above z = 0 as one object, and first a crumb of the table."""
    points, floor = cloud_of(image).points, SupportPlane(np.array([0.0, 0.0, 1.0]), 0.0)
    table, things = points[points[:, 2] < 0.002], points[points[:, 2] > 0.004]
    unnamed = DetectConfig(classify=False)
    return [
        make_detection(some, viewpoint=image.viewpoint, support=floor, config=unnamed) for some in (table[:200], things)
    ]


NOT_A_FUNCTION = 3
