"""A family of procedural shapes: how its members are made, and what is known of the class beside their shape."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import trimesh

# Prior share of a variant, exp(-2.5): a view must speak for the variant by 2.5 in negative log odds before it wins over
# its class.
_SHARE_OF_VARIANT = 0.0820849986
# What is known of a class that holds for its variants, too.
_SHARED = ("rests", "hollow", "density_kg_m3", "optional_parts")


@dataclass(frozen=True, eq=False)
class Made:
    """What a family makes of one random generator.

    Attributes:
        mesh: One watertight body, m, z up, axis at x = y = 0, a handle or the front towards +x.
        kind: Variant within the family.
        wall_m: Thickness of the wall, m; 0 where the object is modelled as a solid.
    """

    mesh: trimesh.Trimesh
    kind: str
    wall_m: float = 0.0


@dataclass(frozen=True, eq=False)
class Family:
    """A class of procedural shapes.

    Attributes:
        name: Name of the class.
        make: Makes one member.
        group: "household" or "traffic".
        spec: Fields of the class's CategorySpec that its members cannot tell.
        variants: Kinds that have a primitive of their own, because the mean of all members cannot bend into them, each
            with the fields of its CategorySpec.
        also: Kinds that are members of other classes as well, with those classes.
        members: Number of shapes that the primitive is built from.
    """

    name: str
    make: Callable[[np.random.Generator], Made]
    group: Literal["household", "traffic"]
    spec: Mapping[str, object] = field(default_factory=dict)
    variants: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    also: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    members: int = 80

    @property
    def names(self) -> tuple[str, ...]:
        """The class, then its variants as "class.variant": each has a primitive."""
        return self.name, *(f"{self.name}.{variant}" for variant in self.variants)

    def members_of(self, name: str) -> int:
        """Number of shapes that the primitive of the class, or of one of its variants, is built from at most."""
        return self.members if name == self.name else self.members // 2

    def spec_of(self, name: str) -> dict[str, object]:
        """Fields of the CategorySpec of the class ("cup") or of one of its variants ("cup.stemmed")."""
        _, _, variant = name.partition(".")
        if not variant:
            return dict(self.spec)
        shared = {key: self.spec[key] for key in _SHARED if key in self.spec}
        return {**shared, "share": _SHARE_OF_VARIANT, **self.variants[variant]}


def draw_kind(rng: np.random.Generator, shares: Mapping[str, float]) -> str:
    """One kind, drawn by the share of each kind among the members of a family; the shares sum to one."""
    return str(rng.choice(list(shares), p=list(shares.values())))
