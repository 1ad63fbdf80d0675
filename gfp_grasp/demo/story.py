"""What the demonstration has to show of one picture: its objects, what became of them, and the pictures themselves."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import trimesh

from gfp_grasp.complete import Completion
from gfp_grasp.grasps import Gripper
from gfp_grasp.metrics import CompletionErrors
from gfp_grasp.transforms import apply_T
from gfp_grasp.types import Grasp, Outcome


@dataclass(frozen=True, eq=False)
class Item:
    """One object of a story.

    Attributes:
        name: Short and different from the others' of its story.
        completion: What was made of it.
        grasps: Planned on the completion, best first.
        outcome: Of the best grasp, or None where it was not tried.
        world: What the grasp was tried on: "true object", or "completed parts" where the truth is unknown.
        truth: True mesh in place, or None.
        errors: Of the completion against the truth, or None.
        grasp_s: Seconds of planning.
    """

    name: str
    completion: Completion
    grasps: tuple[Grasp, ...] = ()
    outcome: Outcome | None = None
    world: str = ""
    truth: trimesh.Trimesh | None = None
    errors: CompletionErrors | None = None
    grasp_s: float = 0.0

    @property
    def residual_m(self) -> float:
        """Of the fit, m; NaN where there was none."""
        return self.completion.fit.residual_m if self.completion.fit else float("nan")

    @property
    def seconds(self) -> float:
        """Of completing, without planning."""
        return float(sum(self.completion.timings_s.values()))


@dataclass(frozen=True, eq=False)
class Story:
    """One picture and what came of it.

    Attributes:
        title: Heading.
        text: A sentence or two.
        items: Its objects.
        folder: Where its files are.
        pictures: File names in the folder, each with its caption.
        files: What else was written there.
    """

    title: str
    text: str
    items: tuple[Item, ...]
    folder: Path
    pictures: dict[str, str] = field(default_factory=dict)
    files: tuple[str, ...] = ()


HEADINGS = ("object", "class", "fit, mm", "CD, mm", "F", "parts", "grasps", "best grasp", "complete, s", "plan, s")


def row(item: Item) -> tuple[str, ...]:
    """Figures of an item under HEADINGS, as text."""
    score = item.completion.scores.get(item.completion.category)
    tried = item.outcome.reason.replace("_", " ") if item.outcome else ("not tried" if item.grasps else "none found")
    return (
        item.name,
        item.completion.category + (f" {score:.2f}" if score is not None else ""),
        f"{1000 * item.residual_m:.1f}" if np.isfinite(item.residual_m) else "",
        f"{1000 * item.errors.cd_m:.1f}" if item.errors else "?",
        f"{item.errors.f_score:.2f}" if item.errors else "?",
        str(len(item.completion.parts)),
        str(len(item.grasps)),
        tried,
        f"{item.seconds:.1f}",
        f"{item.grasp_s:.1f}",
    )


def gripper_mesh(grasp: Grasp) -> trimesh.Trimesh:
    """The open gripper at a grasp, for looking at: boxes, world frame."""
    boxes = Gripper().solids(np.array([grasp.width_m]))[0]
    meshes = [trimesh.creation.box(bounds=box) for box in boxes]
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    faces = np.concatenate([mesh.faces + 8 * i for i, mesh in enumerate(meshes)])
    return trimesh.Trimesh(apply_T(grasp.T_world_gripper, vertices), faces, process=False)
