"""Which classes stand in streets, how often, and where."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class InStreets:
    """How a class takes part in a street.

    Attributes:
        share: Share of all vehicles and people.
        places: Where it may be, each as likely: "parked" at a kerb, "moving" on a lane, on the "pavement", or in a
            "yard" behind it.
        crosses: Whether on the road it may face any way.
    """

    share: float
    places: tuple[str, ...]
    crosses: bool = False


IN_STREETS: Mapping[str, InStreets] = {
    "car": InStreets(0.50, ("parked", "moving", "yard")),
    "van": InStreets(0.10, ("parked", "moving", "yard")),
    "truck": InStreets(0.06, ("parked", "moving", "yard")),
    "bus": InStreets(0.04, ("parked", "moving")),
    "pedestrian": InStreets(0.16, ("pavement", "pavement", "moving", "yard"), crosses=True),
    "cyclist": InStreets(0.08, ("moving",)),
    "motorcycle": InStreets(0.04, ("moving", "pavement")),
    "bicycle": InStreets(0.04, ("pavement",)),
}
STREET_FURNITURE = ("traffic_sign", "traffic_cone")
