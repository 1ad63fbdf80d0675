"""Rows of a score that are written by hand."""

from gfp_grasp.score import ScoreRow


def a_row(name: str, view: int, truth: bool, completed: bool, rank: int | None = None) -> ScoreRow:
    reasons = ["held" if held else "no_contact" for held in (truth, completed)]
    return ScoreRow(
        object="a",
        category="cup",
        completer=name,
        view=view,
        episode_seed=1,
        success=truth,
        reason=reasons[0],
        lift_m=0.2,
        slip_m=0.0,
        falls_free=truth,
        least_friction=0.2 if truth else None,
        margin=3.0 if truth else 0.0,
        mass_kg=0.2,
        friction=0.7,
        grip_n=30.0,
        completed_success=completed,
        completed_reason=reasons[1],
        quality=0.5,
        width_m=0.05,
        cd_m=0.01,
        f_score=0.7,
        rank_held=rank,
    )
