"""How a primitive is registered, and how the refinement weighs its evidence."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gfp_grasp.errors import InvalidOption
from gfp_grasp.types import GenericPrimitive


@dataclass(frozen=True)
class RefineConfig:
    """How the refinement weighs its evidence. Its lengths are shares of one unit, which goes with the primitive.

    Attributes:
        unit_m: Length, m, of which the other lengths are shares; None is the primitive's own size.
        steps: Robust scales, shares, one for each Gauss-Newton step, from coarse to fine.
        effective_points: Number of independent points that a view is worth against the prior.
        misfit: Standard deviation of what the modes cannot express, a share.
        tangential: Weight of a point's distance along the surface, relative to its distance across the surface.
        silhouette: Standard deviation of a free-space violation, shares for a real view and a guessed silhouette.
        scale_slack: Factor on the class's standard deviation of the logarithm of scale.
        estimate_scale: Fit scale with the pose.
        estimate_modes: Fit the shape modes with the pose.
        free_space: Use the view's free space.
        support: Have the lowest point touch the support.
        ellipticity: Standard deviation of the ellipticity of the body (see `ellipticity_gram`), a share; None leaves
            the ellipticity to the modes.
        num_points: Largest number of points of the evidence that are used.
        num_samples: Number of samples of the primitive's surface.
        num_modes: Largest number of modes that are fitted; the others stay at the mean.
    """

    unit_m: float | None = None
    steps: tuple[float, ...] = (0.104, 0.073, 0.052, 0.042, 0.042, 0.031, 0.031, 0.031)
    effective_points: float = 150.0
    misfit: float = 0.0104
    tangential: float = 0.05
    silhouette: tuple[float, float] = (0.021, 0.042)
    scale_slack: float = 1.5
    estimate_scale: bool = True
    estimate_modes: bool = True
    free_space: bool = True
    support: bool = True
    ellipticity: float | None = None
    num_points: int = 400
    num_samples: int = 1500
    num_modes: int = 24

    def __post_init__(self) -> None:
        if not self.steps or min(self.steps) <= 0:
            raise InvalidOption(
                f"steps is {self.steps}; one positive robust scale, a share of the size, for each step is expected"
            )
        if min(self.effective_points, self.misfit, *self.silhouette, self.scale_slack) <= 0:
            raise InvalidOption("effective_points, misfit, silhouette and scale_slack must be positive")
        if self.ellipticity is not None and self.ellipticity <= 0:
            raise InvalidOption(f"ellipticity is {self.ellipticity}; a positive share of the unit or None is expected")
        if min(self.num_points, self.num_samples) < 20:
            raise InvalidOption(f"{self.num_points} points and {self.num_samples} samples: at least 20 are needed")
        if self.num_modes < 1:
            raise InvalidOption(f"num_modes is {self.num_modes}; at least 1 is expected")
        if self.unit_m is not None and self.unit_m <= 0:
            raise InvalidOption(f"unit_m is {self.unit_m}; a positive length or None is expected")

    def unit_of(self, primitive: GenericPrimitive) -> float:
        """Length, m, of which the other lengths are shares for a primitive."""
        return primitive.size_m if self.unit_m is None else self.unit_m


_QUICK = RefineConfig(steps=(0.208, 0.156, 0.104, 0.083, 0.0625), num_points=100, num_samples=400, num_modes=5)
_MIDDLE = RefineConfig(steps=(0.156, 0.104, 0.073, 0.052, 0.042), num_points=250, num_samples=1000)
_THOROUGH = RefineConfig(steps=(0.042, 0.031, 0.031))

STARTS = ("proposal", "box", "pcrnet")
HYPOTHESES = ("upright", "upside_down", "lying")


@dataclass(frozen=True)
class FitConfig:
    """How a primitive is registered.

    Attributes:
        start: "proposal" starts where one look at the object proposes and, where that is unsure, from boxes; "box"
            starts from the box of the points in every way that it may rest and be turned; "pcrnet" corrects each of
            these by the network.
        hypotheses: The ways in which the object may rest on the support.
        quick: Refinement of every start.
        middle: Refinement of the best few starts.
        thorough: Refinement of those that are still near the best after the middle one.
        kept_share: Share of the starts that outlive the first two quick steps.
        num_kept: Number of starts that get the middle refinement.
        prune_margin: After the middle refinement, a start whose cost exceeds the best by more than this is pruned.
        rival_margin: After the first steps, a primitive whose best start exceeds another's by more than this, and by
            more than a quarter of its cost, is pruned.
        rival_margin_quick: The same margin after the quick steps.
        occlusion: Ask whether something hides a part of a cloud that came without its view.
        roundness: Ask whether the body is as deep as it is wide.
        size: (3,) scale of every start along the primitive's axes, ones for its own; None estimates it from the points.
        refine: Refine the starts; False takes the best start as it is.
        max_residual: A fit whose trimmed residual is a larger share of the unit has diverged.
    """

    start: Literal["proposal", "box", "pcrnet"] = "proposal"
    hypotheses: tuple[str, ...] = HYPOTHESES
    quick: RefineConfig = _QUICK
    middle: RefineConfig = _MIDDLE
    thorough: RefineConfig = _THOROUGH
    kept_share: float = 0.4
    num_kept: int = 3
    prune_margin: float = 15.0
    rival_margin: float = 50.0
    rival_margin_quick: float = 25.0
    occlusion: bool = True
    roundness: bool = True
    size: tuple[float, float, float] | None = None
    refine: bool = True
    max_residual: float = 0.52

    def __post_init__(self) -> None:
        if self.start not in STARTS:
            raise InvalidOption(f"start is {self.start!r}; one of {', '.join(STARTS)} is expected")
        unknown = set(self.hypotheses) - set(HYPOTHESES)
        if unknown or not self.hypotheses:
            raise InvalidOption(f"hypotheses are {self.hypotheses}; some of {HYPOTHESES} are expected")
        if not 0 < self.kept_share <= 1:
            raise InvalidOption(f"kept_share is {self.kept_share}; a share in (0, 1] is expected")
        if self.size is not None and not (len(self.size) == 3 and min(self.size) > 0):
            raise InvalidOption(f"size is {self.size}; three positive factors are expected")
        if min(self.prune_margin, self.rival_margin, self.rival_margin_quick) < 0:
            raise InvalidOption(
                f"prune_margin is {self.prune_margin}, rival_margin {self.rival_margin} and rival_margin_quick "
                f"{self.rival_margin_quick}; costs from 0 on are expected"
            )
        if self.num_kept < 1:
            raise InvalidOption(f"num_kept is {self.num_kept}; at least one start must be refined")

    def with_unit(self, unit_m: float) -> FitConfig:
        """The same with one unit for all of its refinements."""
        refinements = {name: replace(getattr(self, name), unit_m=unit_m) for name in ("quick", "middle", "thorough")}
        return replace(self, **refinements)


_RIGID = RefineConfig(estimate_scale=False, estimate_modes=False, free_space=False)


def icp_config(*, size: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> FitConfig:
    """Rigid point-to-plane ICP of the mean primitive, from the starts of the default fit.

    Args:
        size: (3,) scale of the primitive along its axes; ones are its own size.
    """
    config = FitConfig(start="box", roundness=False, size=size, num_kept=1)
    return replace(
        config,
        quick=replace(_RIGID, steps=config.quick.steps),
        middle=replace(_RIGID, steps=config.middle.steps),
        thorough=replace(_RIGID, steps=config.thorough.steps),
    )


def pcrnet_config(*, size: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> FitConfig:
    """PCRNet's five iterations on the mean primitive and nothing after them (GFPNet sec. III-A).

    Args:
        size: (3,) scale of the primitive along its axes; ones are its own size.
    """
    return FitConfig(start="pcrnet", roundness=False, size=size, refine=False, thorough=_RIGID)


def size_of_extents(primitive: GenericPrimitive, extents: np.ndarray) -> tuple[float, float, float]:
    """Scale that gives a primitive a height and a mean width.

    Args:
        primitive: What is scaled.
        extents: (3,) m, true extents along the axes of the object as it stands.
    """
    own = np.ptp(primitive.vertices, axis=0)
    wide = float(extents[:2].mean() / own[:2].mean())
    return wide, wide, float(extents[2] / own[2])
