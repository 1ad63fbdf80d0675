"""The page of a score: how far completers come between their brackets, why they fail, and what that looks like."""

from gfp_grasp.scorepage.page import FIGURES, prepare_folder, write_score_page
from gfp_grasp.scorepage.picture import write_picture

__all__ = ["FIGURES", "prepare_folder", "write_picture", "write_score_page"]
