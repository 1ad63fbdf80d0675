"""Lengths that cannot be metres: which unit they may be in, for messages."""

# Units to a metre. Depth cameras count in tenths of a millimetre too.
_UNITS = {
    "inches": 1 / 0.0254,
    "centimetres": 100.0,
    "millimetres": 1000.0,
    "tenths of a millimetre": 10_000.0,
    "micrometres": 1e6,
}


def unit_advice(length: float, *, least_m: float, most_m: float) -> str:
    """What a length that is not in metres may be in, and how to make metres of it.

    Args:
        length: As it came, positive.
        least_m: Least length that makes sense, m.
        most_m: Largest length that makes sense, m.

    Returns:
        "in millimetres it would be 0.25 m: divide by 1000", with "or" between units where several make sense; "no
        common unit makes sense of it" where none does.
    """
    if 0 < length < least_m <= 1000 * length <= most_m:
        return f"if it was divided by 1000 once too often, multiply by 1000: it would be {1000 * length:.3g} m"
    ways = [
        f"in {name} it would be {length / count:.3g} m: divide by {round(count, 2):.10g}"
        for name, count in _likely(length, least_m, most_m)
    ]
    return ", or ".join(ways) or "no common unit makes sense of it"


def scale_advice(length: float, *, least_m: float, most_m: float) -> str:
    """The option --scale that makes metres of a length, for each unit that makes sense; see `unit_advice`."""
    if 0 < length < least_m <= 1000 * length <= most_m:
        return "by --scale 1000 if it was divided by 1000 once too often"
    ways = [f"by --scale {1 / count:.4g} if it is in {name}" for name, count in _likely(length, least_m, most_m)]
    return ", ".join(ways) or "by --scale and the metres of one of its units"


def _likely(length: float, least_m: float, most_m: float) -> list[tuple[str, float]]:
    return [(name, count) for name, count in _UNITS.items() if least_m <= length / count <= most_m]
