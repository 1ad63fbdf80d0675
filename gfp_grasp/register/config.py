"""How a primitive is registered."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from gfp_grasp.errors import InvalidOption
from gfp_grasp.register.state import ModesConfig

_QUICK = ModesConfig(steps=(0.02, 0.015, 0.01, 0.008, 0.006), num_points=100, num_samples=400, num_modes=5)
_MIDDLE = ModesConfig(steps=(0.015, 0.01, 0.007, 0.005, 0.004), num_points=250, num_samples=1000)
_THOROUGH = ModesConfig(steps=(0.004, 0.003, 0.003))

HYPOTHESES = ("upright", "upside_down", "lying")


@dataclass(frozen=True)
class FitConfig:
    """How a primitive is registered.

    Attributes:
        start: "pcrnet" corrects every start by the network, "box" leaves it as the box of the points gives it.
        hypotheses: How the object may rest on the support.
        quick: Refinement of every start.
        middle: Refinement of the best few.
        thorough: Refinement of those of them that are still near the best after that.
        survivors: Share of the starts that outlive the first two quick steps.
        keep: Starts of which there is a middle refinement.
        behind: A start whose cost is larger than the best's by this after that is given up.
        rival_behind: A primitive whose best start is behind another's by this after the first steps is given up.
        rival_raced_behind: The same after the quick steps.
        roundness: Ask whether the body is as deep as it is wide.
        size: (3,) scale of every start along the primitive's axes, ones for its own; None leaves it to the points.
        refine: Refine the starts; False takes the best of them as it is.
        max_residual_m: A fit whose trimmed residual is larger has diverged.
    """

    start: Literal["pcrnet", "box"] = "box"
    hypotheses: tuple[str, ...] = HYPOTHESES
    quick: ModesConfig = _QUICK
    middle: ModesConfig = _MIDDLE
    thorough: ModesConfig = _THOROUGH
    survivors: float = 0.4
    keep: int = 3
    behind: float = 15.0
    rival_behind: float = 50.0
    rival_raced_behind: float = 25.0
    roundness: bool = True
    size: tuple[float, float, float] | None = None
    refine: bool = True
    max_residual_m: float = 0.05

    def __post_init__(self) -> None:
        if self.start not in ("pcrnet", "box"):
            raise InvalidOption(f"start is {self.start!r}; 'pcrnet' or 'box' is expected")
        unknown = set(self.hypotheses) - set(HYPOTHESES)
        if unknown or not self.hypotheses:
            raise InvalidOption(f"hypotheses are {self.hypotheses}; some of {HYPOTHESES} are expected")
        if not 0 < self.survivors <= 1:
            raise InvalidOption(f"survivors is {self.survivors}; a share in (0, 1] is expected")
        if self.size is not None and not (len(self.size) == 3 and min(self.size) > 0):
            raise InvalidOption(f"size is {self.size}; three positive factors are expected")
        if min(self.behind, self.rival_behind, self.rival_raced_behind) < 0:
            raise InvalidOption(
                f"behind is {self.behind}, rival_behind {self.rival_behind} and rival_raced_behind "
                f"{self.rival_raced_behind}; costs from 0 on are expected"
            )
        if self.keep < 1:
            raise InvalidOption(f"keep is {self.keep}; at least one start must be refined")
