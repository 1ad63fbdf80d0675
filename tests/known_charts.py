"""Charts of figures that are unlike each other; `python tests/known_charts.py` writes them to tests/known_charts/."""

from pathlib import Path

from gfp_grasp.drawing import (
    bracket_chart,
    reasons_chart,
    reasons_legend,
    write_bars,
    write_curves,
    write_front,
    write_learning_curves,
    write_peers,
)
from gfp_grasp.types import REASONS

FOLDER = Path(__file__).with_suffix("")


def _rates(successes: int, attempts: int, low: float, high: float, **more: object) -> dict:
    rates = {"attempts": attempts, "successes": successes, "success_rate": successes / attempts, "ci95": [low, high]}
    return {**rates, **more}


def success() -> str:
    """Three rows, two of them brackets, and a name that is too long."""
    rows = {
        "oracle": _rates(3, 4, 0.3, 0.95, completed_world=_rates(4, 4, 0.5, 1.0)),
        "<mine>:with_a_very_long_name/my-planner": _rates(2, 5, 0.1, 0.8, completed_world=_rates(1, 5, 0.05, 0.6)),
        "observed": _rates(1, 4, 0.05, 0.7, completed_world=_rates(0, 4, 0.0, 0.5)),
    }
    return bracket_chart(rows, ("observed", "oracle"))


def half_way() -> str:
    """A bracket whose rate is a half, alone."""
    rows = {"oracle": _rates(2, 4, 0.1, 0.9, completed_world=_rates(3, 4, 0.3, 1.0)), "own": _rates(1, 4, 0.0, 0.6)}
    rows["own"]["completed_world"] = _rates(1, 2, 0.2, 0.7)
    return bracket_chart(rows, ("observed", "oracle"))


def reasons() -> str:
    """All reasons, one of them too seldom for its number, and a row that has one only."""
    counts = dict(zip(REASONS, (29, 7, 3, 5, 6, 4, 9, 1), strict=True))
    rows = {"own": {"attempts": 64, "reasons": counts}, "<other>": {"attempts": 4, "reasons": {"unstable": 4}}}
    return f"<div>{reasons_chart(rows)}\n{reasons_legend(rows)}</div>"


def bars(path: Path) -> str:
    """Two classes, a method that has no figures in one of them, and one that has none at all."""
    rows = {
        "cup": {"other": {"cd_m": 0.012}, "gfpnet": {"cd_m": 0.004}, "none": {}},
        "all": {"other": {"cd_m": None}, "gfpnet": {"cd_m": 0.006}, "none": {}},
    }
    return write_bars(rows, path, title="Bars & more").read_text(encoding="utf-8")


def curves(path: Path) -> str:
    """More curves than colours, of two lengths, and a panel of one curve beside them."""
    rows = {name: [4.0, 2.0 - 0.1 * i, 1.0][: 3 - i % 2] for i, name in enumerate("abcdef")}
    panels = {"six & more": rows, "one": {"g": [3.0, 3.5, 2.5]}}
    return write_curves(panels, path, title="Curves & more", axis="iterations").read_text(encoding="utf-8")


def front(path: Path) -> str:
    """Six networks, three of them in front, and one of these marked."""
    ms = (0.8, 30.0, 12.0, 210.0, 2.5, 60.0)
    cd = (9.75, 9.1, 8.6, 8.125, 10.5, 9.9)
    rows = [{"name": f"<{i}>, m = {i}", "ms": m, "cd_units": c} for i, (m, c) in enumerate(zip(ms, cd, strict=True))]
    found = [rows[0], rows[2], rows[3]]
    return write_front(rows, found, rows[3], path, title="Networks & more").read_text(encoding="utf-8")


def learning(path: Path) -> str:
    """Four networks, of which one has losses below zero and one hardly learns."""
    curves = {
        "falls": [(10 * n, 0.9 * 0.8**n + 0.02, 0.9 * 0.8**n + 0.05) for n in range(1, 21)],
        "rises & falls": [(n, -0.5 - 0.1 * n, 0.4 - 0.1 * n) for n in range(1, 7)],
        "still": [(100, 0.31, 0.32), (200, 0.312, 0.318)],
        "one": [(7, 3.0, 4.0)],
    }
    return write_learning_curves(curves, path, title="Learning <curves>").read_text(encoding="utf-8")


def peers(path: Path) -> str:
    """Two groups, a peer that has one way only in one of them, one without an answer, and curves that end together."""
    names = ("partial", "pcn", "pcn-true-box", "3d-epn", "gfpnet")
    groups = {
        "cup": {name: {"cd_m": 0.001 * 3**i} for i, name in enumerate(names)},
        "a & b": {"partial": {"cd_m": 0.4}, "pcn-true-box": {"cd_m": 0.02}, "3d-epn": {"cd_m": None}},
    }
    shares: dict[str, dict] = {
        str(share): {name: {"cd_m": 0.01 + 0.01 * share} for name in names} for share in (0.0, 0.45, 0.9)
    }
    shares["0.45"]["pcn"] = {"cd_m": None}
    return write_peers(groups, shares, path).read_text(encoding="utf-8")


def drawn(scratch: Path) -> dict[str, str]:
    """All charts by name; the scratch file is written over."""
    return {
        "success": success(),
        "half_way": half_way(),
        "reasons": reasons(),
        "bars": bars(scratch),
        "curves": curves(scratch),
        "learning": learning(scratch),
        "front": front(scratch),
        "peers": peers(scratch),
    }


if __name__ == "__main__":
    for name, chart in drawn(FOLDER / "bars.svg").items():
        (FOLDER / f"{name}.svg").write_text(chart.rstrip("\n") + "\n", encoding="utf-8")
