"""5. Score a completer of your own between its brackets: the hull of the seen points and the true mesh.

`python -m gfp_grasp.examples.05_score_your_completer [NUM_OBJECTS]`
"""

import sys

import trimesh

from gfp_grasp.score import ScoreConfig, score
from gfp_grasp.types import Detection


def upright_box(detection: Detection) -> trimesh.Trimesh:
    """A completer: a function from a `Detection` to a mesh in its frame. This one fills the box of the seen points."""
    points = detection.cloud.points
    return trimesh.creation.box(bounds=[points.min(axis=0), points.max(axis=0)])


if __name__ == "__main__":
    # Names reach the workers of a score; a function has the name of its module before a colon.
    mine = "gfp_grasp.examples.05_score_your_completer:upright_box"
    limit = int(sys.argv[1]) if len(sys.argv) > 1 else 6
    config = ScoreConfig(views=1, limit=limit)
    report = score("all", ("observed", mine, "oracle"), config=config)
    for row in report.table():
        print(f"{row['completer']}: held {row['true world']}, CD {row['CD mm']} mm, failures: {row['failures']}")
    for other, pairs in report.paired()[mine].items():
        print(f"beside {other}: {pairs['only_this']} held by yours alone, {pairs['only_other']} by the other alone")
    report.write("score.json")
