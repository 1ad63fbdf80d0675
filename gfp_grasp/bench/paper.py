"""The paper's table I beside the same methods here.

Its metres are no target: its figure for PCRNet alone exceeds a cup. What can be compared are the ratios within a table.
"""

from __future__ import annotations

from collections.abc import Mapping

# Chamfer distance, m, on ModelNet's test split. Source: Cocias, Razvant and Grigorescu, GFPNet (RA-L 2020), table I.
PAPER_CD_M = {
    "PCRNet": {"cup": 0.109, "bottle": 0.144},
    "GFS": {"cup": 0.027, "bottle": 0.029},
    "GFPNet": {"cup": 0.011, "bottle": 0.009},
}
_ROWS = {"PCRNet": "pcrnet", "GFS": "pcrnet-gfs", "GFPNet": "pcrnet-gfpnet-paper"}


def table_one(rows: Mapping[str, Mapping[str, Mapping]]) -> dict[str, dict[str, dict[str, float | None]]]:
    """The paper's methods by class, as it gives them and as they come out here.

    Args:
        rows: {class: {method: figures with "cd_m"}} of `bench_completion`.

    Returns:
        {method: {class: {"paper_m", "rigid_m", "sized_m"}}}: `rigid_m` with the mean primitive at its own size as in
        the paper, `sized_m` with the true height and width given; None where it was not measured.
    """

    def cd_m(category: str, method: str) -> float | None:
        return rows.get(category, {}).get(method, {}).get("cd_m")

    return {
        name: {
            category: {
                "paper_m": paper_m,
                "rigid_m": cd_m(category, _ROWS[name]),
                "sized_m": cd_m(category, f"{_ROWS[name]}-sized"),
            }
            for category, paper_m in by_class.items()
        }
        for name, by_class in PAPER_CD_M.items()
    }
