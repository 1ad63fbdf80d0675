"""The page of a score: how far completers come between their brackets, why they fail, and what that looks like."""

from gfp_grasp.scorepage.page import FIGURES, prepare_folder, write_score_page

__all__ = ["FIGURES", "prepare_folder", "write_score_page"]
