"""Measures of the bicycles that there are."""

from __future__ import annotations

import numpy as np

from gfp_grasp.shapes.cycle import Cycle


def draw_cycle(rng: np.random.Generator, style: str) -> Cycle:
    """One bicycle: "city", "trekking", "mountain", "road", "folding" or "child"."""
    u = rng.uniform
    size = {"child": u(0.5, 0.85), "mountain": u(0.95, 1.06)}.get(style, u(0.93, 1.05))
    wheel = {
        "city": u(0.33, 0.362), "trekking": u(0.335, 0.36), "mountain": u(0.325, 0.372), "road": u(0.332, 0.345),
        "folding": u(0.2, 0.265), "child": u(0.28, 0.36),
    }[style]  # fmt: skip
    tyre = {
        "mountain": u(0.023, 0.03), "road": u(0.0125, 0.017), "folding": u(0.018, 0.025), "child": u(0.022, 0.03),
    }.get(style, u(0.016, 0.025))  # fmt: skip
    slack = {"city": 0.05, "mountain": 0.06, "road": -0.04, "folding": 0.0}.get(style, 0.02)
    bottom = u(0.26, 0.31)
    saddle = {"child": u(0.78, 0.95), "road": u(0.92, 1.06), "folding": u(0.85, 1.0)}.get(style, u(0.85, 1.05))
    tube = {"mountain": u(0.38, 0.5), "folding": u(0.32, 0.42), "child": u(0.36, 0.46)}.get(style, u(0.45, 0.58))
    through = u(0.75, 0.92)
    if style in ("city", "folding", "child") and rng.random() < 0.65:
        through = u(0.35, 0.6)
    stem = {
        "city": (u(-0.02, 0.07), u(0.08, 0.24)), "road": (u(0.07, 0.12), u(-0.01, 0.05)),
        "folding": (u(-0.03, 0.03), u(0.2, 0.36)), "child": (u(0.0, 0.05), u(0.06, 0.24)),
    }.get(style, (u(0.03, 0.1), u(0.02, 0.12)))  # fmt: skip
    # The seat tube keeps clear of the rear wheel.
    seat_rad, low = np.radians(u(69, 75)), bottom - wheel
    clear = (wheel + 0.035 - low * np.cos(seat_rad)) / np.sin(seat_rad)
    return Cycle(
        size=size, wheel_m=wheel, tyre_m=tyre, base_m=1.04 + slack + u(-0.03, 0.05),
        stay_m=max(u(0.41, 0.46), float(np.hypot(clear, low))), bottom_m=bottom, seat_rad=seat_rad, seat_tube_m=tube,
        saddle_m=max(saddle, bottom + tube * 0.97 + 0.08), saddle_long_m=u(0.24, 0.29),
        head_rad=np.radians(u(68, 73.5)), head_m=u(0.1, 0.2), stem_m=stem, through=through,
        crank_m=u(0.155, 0.178), crank_rad=np.radians(np.clip(rng.normal(0, 35), -70, 70)),
        steer_rad=np.radians(np.clip(rng.normal(0, 7), -22, 22)), girth=(tyre / 0.022) ** 0.6 * u(0.92, 1.15),
        **_bar(rng, style),
    )  # fmt: skip


def _bar(rng: np.random.Generator, style: str) -> dict[str, tuple[float, float, float]]:
    """Where the left handlebar goes: straight, swept back or dropped."""
    u = rng.uniform
    wide = {"mountain": u(0.3, 0.38), "road": u(0.2, 0.225)}.get(style, u(0.26, 0.33))
    if style == "road":
        bend, grip, end = (0.0, 0.6 * wide, 0.0), (u(0.06, 0.1), wide, 0.0), (u(0.02, 0.06), wide + 0.01, -u(0.1, 0.14))
    elif style == "city" and rng.random() < 0.7:
        rise = u(0.0, 0.06)
        bend, grip = (u(0.0, 0.04), 0.45 * wide, rise), (u(-0.04, 0.02), 0.85 * wide, rise)
        end = (-u(0.1, 0.22), wide, rise - u(0.0, 0.05))
    else:
        rise, back = u(-0.01, 0.05), u(0.0, 0.06)
        bend, grip, end = (0.01, 0.25 * wide, 0.3 * rise), (0.0, 0.6 * wide, rise), (-back, wide, rise)
    return {"bend_m": bend, "grip_m": grip, "end_m": end}
