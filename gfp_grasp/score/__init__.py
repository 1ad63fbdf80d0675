"""The score of completers: their grasps tried in the simulator, the report, and a page that shows it."""

from gfp_grasp.score.page import FIGURES, prepare_folder, write_picture, write_score_page
from gfp_grasp.score.report import BRACKETS, Report, ScoreRow, mcnemar_p, wilson_interval
from gfp_grasp.score.rows import ScoreConfig
from gfp_grasp.score.run import ALL_CLASSES, BRACKETED, score
from gfp_grasp.score.sets import TOGETHER, read_report, study

__all__ = [
    "ALL_CLASSES",
    "BRACKETED",
    "BRACKETS",
    "FIGURES",
    "TOGETHER",
    "Report",
    "ScoreConfig",
    "ScoreRow",
    "mcnemar_p",
    "prepare_folder",
    "read_report",
    "score",
    "study",
    "wilson_interval",
    "write_picture",
    "write_score_page",
]
