"""A page that shows, in the browser, what the package makes of a recording or of an episode; needs the extra `view`.

Importing it does not load viser; only `view_capture` and `view_episodes` do.
"""

from gfp_grasp.view.episodes import EpisodeViewer, view_episodes
from gfp_grasp.view.server import Viewer, view_capture

__all__ = ["EpisodeViewer", "Viewer", "view_capture", "view_episodes"]
