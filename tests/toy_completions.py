"""Completions of boxes, made by hand: what pages and the viewer draw, with figures that are unlike each other."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import trimesh

from gfp_grasp.completion import Completion
from gfp_grasp.drawing import Item
from gfp_grasp.metrics import CompletionErrors
from gfp_grasp.types import (
    CollisionMesh,
    CompletedShape,
    ConvexPart,
    DepthImage,
    Detection,
    Grasp,
    OrientedBox,
    Outcome,
    PointCloud,
    SupportPlane,
)

EXTENTS = (0.06, 0.08, 0.10)


def toy_completion(
    place: tuple[float, float, float] = (0.0, 0.0, 0.05),
    *,
    category: str = "mug",
    num_points: int = 40,
    viewpoint: tuple[float, float, float] | None = (0.5, -0.3, 0.4),
    up: tuple[float, float, float] = (0.0, 0.0, 1.0),
    warning: str = "",
    fit: Any = None,
    **detected: Any,
) -> Completion:
    """A box of two parts whose lower vertices were seen, over a support at z = 0."""
    box = trimesh.creation.box(EXTENTS)
    box.apply_translation(place)
    half = trimesh.creation.box((EXTENTS[0], EXTENTS[1], EXTENTS[2] / 2))
    parts = [ConvexPart(half.vertices + place + (0, 0, sign * EXTENTS[2] / 4), half.faces) for sign in (-1, 1)]
    notes = {"warning": warning} if warning else {}
    shape = CompletedShape(
        mesh=box,
        observed=np.asarray(box.vertices)[:, 2] < place[2],
        sigma_m=np.linspace(0.001, 0.0024, 8),
        fit=fit,
        timings_s={"detect": 0.25, "register": 1.0},
    )
    points = np.random.default_rng(0).uniform(-0.03, 0.03, (num_points, 3)) + place
    support = SupportPlane(np.array([0.0, 0.0, 1.0]), 0.0)
    detection = Detection(
        cloud=PointCloud(points, None if viewpoint is None else np.array(viewpoint)),
        up=np.array(up),
        category=category,
        **{"support": support, "scores": {}, "box": OrientedBox(np.eye(4), np.array(EXTENTS)), **detected},
    )
    made = Completion(shape, detection)
    made.__dict__["collision"] = CollisionMesh(tuple(parts), (0.00012, 0.00345, 0.00678), "cuts", 0.5, notes)
    return made


def toy_grasps(num: int) -> tuple[Grasp, ...]:
    """Grasps from above, each 1 cm higher and narrower than the one before, and of less quality."""
    return tuple(
        Grasp(
            np.array([[1.0, 0, 0, 0.01], [0, -1, 0, 0.02], [0, 0, -1, 0.1 + 0.01 * i], [0, 0, 0, 1]]),
            0.07 - 0.002 * i,
            0.87 - 0.05 * i,
        )
        for i in range(num)
    )


def toy_item(name: str = "mug-1", num_grasps: int = 3, **more: Any) -> Item:
    """A box with grasps; of what is named, the outcome, the truth and the errors are its own."""
    return Item(name, more.pop("completion", None) or toy_completion(), toy_grasps(num_grasps), grasp_s=0.125, **more)


def toy_fit() -> Any:
    """What pages read of a fit, whose primitive is a tetrahedron that is turned by 90 degrees about z."""
    corners = np.array([[0.0, 0, 0], [0.05, 0, 0], [0, 0.06, 0], [0, 0, 0.07]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    T = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    return SimpleNamespace(
        primitive=SimpleNamespace(name="mug.tall", category="mug", faces=faces),
        T_world_object=T,
        residual_m=0.00234,
        hypothesis="upside_down",
        vertices_world=lambda: corners @ T[:3, :3].T,
    )


def toy_errors() -> CompletionErrors:
    return CompletionErrors(cd_m=0.0042, f_score=0.876, scale_error=0.1)


def toy_outcome(success: bool = True, reason: str = "held") -> Outcome:
    return Outcome(success, reason, lift_m=0.2, slip_m=0.0012, falls_free=success)


def toy_image(depth_m: float = 0.5) -> DepthImage:
    """A plane before a camera that looks down from 0.5 m."""
    T = np.array([[1.0, 0, 0, 0.0], [0, -1, 0, 0.0], [0, 0, -1, 0.5], [0, 0, 0, 1]])
    K = np.array([[40.0, 0, 15.5], [0, 40.0, 11.5], [0, 0, 1]])
    return DepthImage(np.full((24, 32), depth_m, np.float32), K, T)
