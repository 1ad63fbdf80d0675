"""What is known of a class beside its shape: how it rests, what it weighs, what it may lack, what others call it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields

from gfp_grasp.errors import InvalidOption

RESTS = ("upright", "upside_down", "lying")
UNKNOWN = "unknown"  # the category of a thing that is of no class
KEEP_RULES = ("seen", "always")
DATASETS = ("modelnet", "shapenet", "kitti")

# Shares of the ways in which things rest on tables; ours, not measured: negative log odds of 0, 4 and 6.
_RESTS = {"upright": 0.9796292072, "upside_down": 0.0179425348, "lying": 0.00242825803}
# kg/m3 over the outer volume: the walls of an open vessel from plastic to stoneware, a closed one from empty to full.
_HOLLOW_DENSITY = (900.0, 2400.0)
_SOLID_DENSITY = (150.0, 1050.0)
_MANY_DIGITS = 6  # of a negative log odds; more than the shares in a card are worth


@dataclass(frozen=True)
class OptionalPart:
    """A part that some members of a class have and others lack.

    Attributes:
        name: One of the primitive's region names, as "handle".
        keep: "seen" leaves the part out of a completion where no point supports it; "always" keeps it.
    """

    name: str
    keep: str = "seen"

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name.isidentifier():
            raise InvalidOption(f"the name of an optional part is {self.name!r}; a region of the primitive is expected")
        if self.keep not in KEEP_RULES:
            raise InvalidOption(
                f"keep of the part {self.name!r} is {self.keep!r}; one of {_listed(KEEP_RULES)} is expected"
            )


@dataclass(frozen=True)
class CategorySpec:
    """What is known of a class, or of a subcategory of one, from its card.

    Attributes:
        category: Full name: "cup", or "cup.stemmed" for a subcategory.
        parent: The class of a subcategory; None for a class.
        size_range_m: Smallest and largest extents ((3,), (3,)) m of the members, along the primitive's own axes.
        rests: Prior probability of each of RESTS; a way in which members never rest is absent.
        hollow: Whether members are open vessels; their walls weigh, not their outer volume.
        density_kg_m3: Lowest and highest density over the volume of the mesh.
        optional_parts: Parts that some members lack.
        alike: Classes that members are easily taken for, because what tells them apart may be out of sight.
        share: Share of the parent's members that are of this subcategory; 1 for a class.
        names: Names of the class in the data sets DATASETS.
    """

    category: str
    parent: str | None = None
    size_range_m: tuple[tuple[float, float, float], tuple[float, float, float]] = ((0.01, 0.01, 0.01), (1.0, 1.0, 1.0))
    rests: Mapping[str, float] = field(default_factory=lambda: dict(_RESTS))
    hollow: bool = False
    density_kg_m3: tuple[float, float] = _SOLID_DENSITY
    optional_parts: tuple[OptionalPart, ...] = ()
    alike: tuple[str, ...] = ()
    share: float = 1.0
    names: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._check_name()
        low, high = (_numbers(end, 3, "size_range_m") for end in _pair(self.size_range_m, "size_range_m"))
        if not all(0 < a <= b for a, b in zip(low, high, strict=True)):
            raise InvalidOption(
                f"size_range_m of {self.category} is {low} to {high}; 0 < smallest <= largest is expected"
            )
        density = _numbers(self.density_kg_m3, 2, "density_kg_m3")
        if not 0 < density[0] <= density[1]:
            raise InvalidOption(f"density_kg_m3 of {self.category} is {density}; 0 < lowest <= highest is expected")
        rests = {str(way): float(prior) for way, prior in dict(self.rests).items()}
        if not rests or set(rests) - set(RESTS) or not all(0 < prior <= 1 for prior in rests.values()):
            raise InvalidOption(
                f"rests of {self.category} is {rests}; priors in (0, 1] of {_listed(RESTS)} are expected"
            )
        if not 0 < float(self.share) <= 1:
            raise InvalidOption(f"share of {self.category} is {self.share}; a number in (0, 1] is expected")
        names = {str(dataset): _words(words, "names") for dataset, words in dict(self.names).items()}
        if set(names) - set(DATASETS):
            raise InvalidOption(
                f"names of {self.category} has {sorted(names)}; some of {_listed(DATASETS)} are expected"
            )
        for name, value in (
            ("size_range_m", (low, high)),
            ("density_kg_m3", density),
            ("rests", rests),
            ("hollow", bool(self.hollow)),
            ("optional_parts", tuple(self.optional_parts)),
            ("alike", _words(self.alike, "alike")),
            ("share", float(self.share)),
            ("names", names),
        ):
            object.__setattr__(self, name, value)

    def _check_name(self) -> None:
        words = self.category.split(".") if isinstance(self.category, str) else []
        if not 1 <= len(words) <= 2 or not all(word.isidentifier() for word in words):
            raise InvalidOption(
                f"category is {self.category!r}; 'class' or 'class.subcategory' is expected, of letters, digits and _"
            )
        if self.parent != (words[0] if len(words) == 2 else None):
            raise InvalidOption(
                f"parent of {self.category} is {self.parent!r}; {words[0]!r} for a subcategory, else None"
            )

    @property
    def cost(self) -> float:
        """Negative log odds of the subcategory against its class: what it has to explain better; 0 for a class."""
        return round(-math.log(self.share), _MANY_DIGITS)

    def rest_costs(self) -> dict[str, float]:
        """Negative log odds of each way in which members rest, against the likeliest."""
        likeliest = max(self.rests.values())
        return {way: round(math.log(likeliest / prior), _MANY_DIGITS) for way, prior in self.rests.items()}

    def as_dict(self) -> dict[str, object]:
        """The spec as it lies in a card: words, numbers, lists and dictionaries of them."""
        content = asdict(self)
        content["optional_parts"] = [asdict(part) for part in self.optional_parts]
        return content

    @classmethod
    def from_dict(cls, content: Mapping[str, object]) -> CategorySpec:
        """A spec from what `as_dict` gives, or from a part of it: what is absent has its default.

        Raises:
            InvalidOption: An unknown or wrong field; the message names it.
        """
        if not isinstance(content, Mapping):
            raise InvalidOption(f"a spec is a {type(content).__name__}; an object with named fields is expected")
        known = [f.name for f in fields(cls)]
        unknown = sorted(set(content) - set(known))
        if unknown or "category" not in content:
            raise InvalidOption(f"a spec has the unknown fields {unknown}, or no category; {_listed(known)} are legal")
        values = dict(content)
        try:
            parts = [OptionalPart(**part) for part in values.pop("optional_parts", ())]  # pyright: ignore
            return cls(**values, optional_parts=tuple(parts))  # pyright: ignore[reportArgumentType]
        except (TypeError, ValueError) as error:
            if isinstance(error, InvalidOption):
                raise
            raise InvalidOption(f"the spec of {content['category']!r} is malformed: {error}") from error


def default_density(*, hollow: bool) -> tuple[float, float]:
    """Lowest and highest density, kg/m3, of an open vessel's walls, or of anything else over its outer volume."""
    return _HOLLOW_DENSITY if hollow else _SOLID_DENSITY


def _pair(values: object, name: str) -> tuple[object, object]:
    pair = tuple(values)  # pyright: ignore[reportArgumentType]
    if len(pair) != 2:
        raise InvalidOption(f"{name} has {len(pair)} entries; the smallest and the largest are expected")
    return pair


def _numbers(values: object, count: int, name: str) -> tuple[float, ...]:
    numbers = tuple(float(value) for value in values)  # pyright: ignore[reportGeneralTypeIssues]
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise InvalidOption(f"{name} has {numbers}; {count} finite numbers are expected")
    return numbers


def _words(values: object, name: str) -> tuple[str, ...]:
    if isinstance(values, str):
        raise InvalidOption(f"{name} has the word {values!r}; a list of words is expected")
    return tuple(str(value) for value in values)  # pyright: ignore[reportGeneralTypeIssues]


def _listed(words: Iterable[str]) -> str:
    return ", ".join(words)
