"""Objects, films, pictures, charts and HTML for the viewer, the demonstration, the page of a score and the benches."""

from gfp_grasp.drawing.bench_charts import (
    write_bars,
    write_confusion,
    write_margins,
    write_operating_curve,
)
from gfp_grasp.drawing.charts import (
    bracket_chart,
    escaped,
    html_page,
    reasons_chart,
    reasons_legend,
    spoken,
    without_paths,
)
from gfp_grasp.drawing.gallery import draw_completions, draw_modes, draw_primitives
from gfp_grasp.drawing.items import Item, gripper_mesh, items_of, joined_boxes, make_item, plan_among
from gfp_grasp.drawing.learning import write_learning_curves
from gfp_grasp.drawing.network_charts import write_curves, write_front
from gfp_grasp.drawing.peers_chart import write_peers
from gfp_grasp.drawing.pictures import (
    apart,
    every_nth,
    filmed_trial,
    overlay,
    paint_objects,
    write_clip,
    write_depth,
)
from gfp_grasp.drawing.scans import (
    ClassColours,
    draw_scan,
    first_look,
    height_greys,
    level_frame_of,
    paled,
    scan_points,
)

__all__ = [
    "ClassColours",
    "Item",
    "apart",
    "bracket_chart",
    "draw_completions",
    "draw_modes",
    "draw_primitives",
    "draw_scan",
    "escaped",
    "every_nth",
    "filmed_trial",
    "first_look",
    "gripper_mesh",
    "height_greys",
    "html_page",
    "items_of",
    "joined_boxes",
    "level_frame_of",
    "make_item",
    "overlay",
    "paint_objects",
    "paled",
    "plan_among",
    "reasons_chart",
    "reasons_legend",
    "scan_points",
    "spoken",
    "without_paths",
    "write_bars",
    "write_clip",
    "write_confusion",
    "write_curves",
    "write_depth",
    "write_front",
    "write_learning_curves",
    "write_margins",
    "write_operating_curve",
    "write_peers",
]
